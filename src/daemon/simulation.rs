//! Simulated devices, pumped: over a pipe in this process for `sim://`, over TCP for `wsg-gateway sim`.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use url::Url;

use crate::gripper::{Connector, clock};
use crate::sim::{Device, DeviceConfig, Interface, LinkAction, Part};
use crate::transport::{Pipe, Traits};

/// What is in flight in one direction of a pipe in this process: about what a socket would hold of small frames.
const PIPE_BYTES: usize = 4096;

/// The models, as URLs name them.
const MODELS: &str = "wsg25, wsg32, wsg50, wsg70";

/// What a pipe in this process means for the protocol: it stands for a device on TCP.
const TRAITS: Traits =
    Traits { name: "sim", connection_oriented: true, bytes_per_second: None, frame_gap: Duration::from_millis(500) };

/// A device to simulate: `sim://wsg50?part_mm=20`.
#[derive(Debug, Clone)]
pub struct SimulatedDevice(DeviceConfig);

impl SimulatedDevice {
    /// Of a model, with what options its URL has: `part_mm`, the width of a part in reach; `firmware`, `fw2` or `fw4`;
    /// `serial_number`.
    ///
    /// # Errors
    /// What is wrong with the URL, and what is allowed.
    pub fn from_url(url: &Url) -> Result<Self, String> {
        let model = url.host_str().unwrap_or_default();
        let mut device = Self::of_model(model).map_err(|error| format!("{url}: {error}"))?;
        for (option, value) in url.query_pairs() {
            device = device.with(&option, &value).map_err(|error| format!("{url}: {error}"))?;
        }
        Ok(device)
    }

    /// Of a model, without a part.
    ///
    /// # Errors
    /// Which models there are.
    pub fn of_model(model: &str) -> Result<Self, String> {
        let config = DeviceConfig::from_model(model);
        config.map(Self).ok_or_else(|| format!("there is no model {model:?}; there are {MODELS}"))
    }

    /// With one option more.
    ///
    /// # Errors
    /// Which options there are, and what they may be.
    pub fn with(mut self, option: &str, value: &str) -> Result<Self, String> {
        let stroke_mm = f64::from(self.0.limits.stroke.mm());
        match option {
            "part_mm" => {
                let fits = |mm: &f64| (0.0..=stroke_mm).contains(mm);
                let width_mm = value.parse().ok().filter(fits);
                let width_mm = width_mm.ok_or_else(|| format!("part_mm={value} must be from 0 to {stroke_mm}"))?;
                self.0 = self.0.with_part(Part::outside(width_mm));
            }
            "firmware" => match value {
                "fw2" => self.0 = self.0.fw2(),
                "fw4" => {}
                _ => return Err(format!("firmware={value} must be fw2 or fw4")),
            },
            "serial_number" => {
                let wrong = |error| format!("serial_number={value}: {error}");
                self.0.serial_number = value.parse().map_err(wrong)?;
            }
            _ => return Err(format!("there is no option {option}; there are part_mm, firmware, serial_number")),
        }
        Ok(self)
    }

    /// Switches it on in this process, on the current runtime.
    pub(super) fn start(self, url: &str) -> InProcess {
        let (pipes, queue) = mpsc::channel(1);
        tokio::spawn(pump(Device::new(self.0, clock::instant()), queue));
        InProcess { url: url.to_owned(), pipes }
    }
}

/// Connects to a simulated device in this process.
#[derive(Debug)]
pub(super) struct InProcess {
    url: String,
    pipes: mpsc::Sender<Pipe>,
}

impl Connector for InProcess {
    fn url(&self) -> String {
        self.url.clone()
    }

    fn traits(&self) -> Traits {
        TRAITS
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        Box::pin(async {
            let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
            self.pipes.send(pipe(theirs)).await.map_err(|_| io::ErrorKind::ConnectionRefused)?;
            Ok(pipe(ours))
        })
    }
}

/// Serves a simulated device on each of these `tcp://` URLs, and says on standard output where, until it is cancelled.
///
/// # Errors
/// Where a URL can't be listened on: which, and why.
pub async fn serve_simulated(urls: &[Url], device: &SimulatedDevice) -> anyhow::Result<()> {
    let mut serving = tokio::task::JoinSet::new();
    for (index, url) in urls.iter().enumerate() {
        let listener = listen(url).await?;
        let mut config = device.0.clone();
        // Two devices are told apart by their serial numbers.
        config.serial_number = config.serial_number.wrapping_add(index as u32);
        println!("a simulated {} at tcp://{}", config.model.name(), listener.local_addr()?);
        let (pipes, queue) = mpsc::channel(1);
        serving.spawn(pump(Device::new(config, clock::instant()), queue));
        serving.spawn(accept(listener, pipes));
    }
    while serving.join_next().await.is_some() {}
    Ok(())
}

async fn listen(url: &Url) -> anyhow::Result<TcpListener> {
    anyhow::ensure!(
        url.scheme() == "tcp",
        "{url}: a simulated device is served on tcp://127.0.0.1:1000; other transports are not supported yet"
    );
    let addresses = url.socket_addrs(|| Some(1000)).map_err(|error| anyhow::anyhow!("{url}: {error}"))?;
    TcpListener::bind(addresses.as_slice()).await.map_err(|error| anyhow::anyhow!("{url}: cannot listen: {error}"))
}

async fn accept(listener: TcpListener, pipes: mpsc::Sender<Pipe>) {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                tracing::info!(%peer, "a client connects");
                // Frames are small, and each is a write of its own.
                let _ = stream.set_nodelay(true);
                if pipes.send(pipe(stream)).await.is_err() {
                    return;
                }
            }
            Err(error) => {
                tracing::warn!(%error, "no connection could be accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

fn pipe(stream: impl tokio::io::AsyncRead + tokio::io::AsyncWrite + Send + 'static) -> Pipe {
    let (reader, writer) = tokio::io::split(stream);
    Pipe { reader: Box::new(reader), writer: Box::new(writer) }
}

/// Runs a device over the pipes that come, one at a time: a second client is turned away, as a device does.
async fn pump(mut device: Device, mut pipes: mpsc::Receiver<Pipe>) {
    let mut connection: Option<Pipe> = None;
    let mut outgoing = Vec::new();
    let mut incoming = vec![0; PIPE_BYTES];
    loop {
        if outgoing.is_empty() && connection.is_some() {
            device.poll_transmit(&mut outgoing);
        }
        if outgoing.is_empty() && device.poll_link() == Some(LinkAction::Drop) {
            connection = None;
            device.disconnect(clock::instant());
        }
        let (reader, writer) = connection.as_mut().map(|pipe| (&mut pipe.reader, &mut pipe.writer)).unzip();
        tokio::select! {
            biased;
            written = async {
                match writer {
                    Some(writer) if !outgoing.is_empty() => writer.write(&outgoing).await,
                    _ => std::future::pending().await,
                }
            } => match written {
                Ok(bytes) if bytes > 0 => drop(outgoing.drain(..bytes)),
                _ => hang_up(&mut device, &mut connection, &mut outgoing),
            },
            read = async {
                match reader {
                    Some(reader) => reader.read(&mut incoming).await,
                    None => std::future::pending().await,
                }
            } => match read {
                Ok(bytes) if bytes > 0 => device.receive(clock::instant(), &incoming[..bytes]),
                _ => hang_up(&mut device, &mut connection, &mut outgoing),
            },
            () = clock::sleep_until(device.poll_timeout()) => device.handle_timeout(clock::instant()),
            next = pipes.recv() => match next {
                Some(next) if connection.is_none() && device.connect(clock::instant(), Interface::Tcp) => connection = Some(next),
                Some(turned_away) => drop(turned_away),
                None if connection.is_none() => return,
                None => {}
            },
        }
    }
}

fn hang_up(device: &mut Device, connection: &mut Option<Pipe>, outgoing: &mut Vec<u8>) {
    *connection = None;
    outgoing.clear();
    device.disconnect(clock::instant());
}
