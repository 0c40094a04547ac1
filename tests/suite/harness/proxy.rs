//! A proxy between gateway and device that records requests and simulates network failures.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::frames::{Frames, Recorder};

const READ_BYTES: usize = 4096;

/// A proxy that keeps one address for its whole life.
#[derive(Debug)]
pub struct Proxy {
    /// Address for the gateway to connect to.
    pub address: SocketAddr,
    /// Frames that the gateway sent.
    pub frames: Frames,
    shared: Arc<Shared>,
    accepting: Option<JoinHandle<()>>,
    /// Keeps the port while nothing listens on it.
    _reservation: TcpSocket,
}

#[derive(Debug)]
struct Shared {
    target: Mutex<SocketAddr>,
    is_stalled: watch::Sender<bool>,
    connections: Mutex<Vec<JoinHandle<()>>>,
    accepted: AtomicUsize,
}

impl Proxy {
    /// A proxy to the device at `target`.
    pub fn to(target: SocketAddr) -> Self {
        let mut proxy = Self::refusing(target);
        proxy.accept();
        proxy
    }

    /// A proxy to the device at `target` that does not listen yet.
    pub fn refusing(target: SocketAddr) -> Self {
        let reservation = reusing(SocketAddr::from(([127, 0, 0, 1], 0)));
        let address = reservation.local_addr().unwrap();
        let shared = Shared {
            target: Mutex::new(target),
            is_stalled: watch::channel(false).0,
            connections: Mutex::default(),
            accepted: AtomicUsize::new(0),
        };
        let (frames, shared) = (Frames::default(), Arc::new(shared));
        Self { address, frames, shared, accepting: None, _reservation: reservation }
    }

    /// Accepts connections from now on.
    pub fn accept(&mut self) {
        let listener = reusing(self.address).listen(16).expect("the port is reserved");
        self.accepting = Some(tokio::spawn(accept(listener, self.shared.clone(), self.frames.clone())));
    }

    /// Refuses connections from now on.
    pub async fn refuse(&mut self) {
        end(self.accepting.take()).await;
    }

    /// Closes all connections on both sides.
    pub async fn cut(&self) {
        let connections = std::mem::take(&mut *self.shared.connections.lock().unwrap());
        for connection in connections {
            end(Some(connection)).await;
        }
    }

    /// Simulates a device that is gone: closes all connections and refuses new ones.
    pub async fn go_away(&mut self) {
        self.refuse().await;
        self.cut().await;
    }

    /// Simulates a half-open link: connections stay, but no bytes pass until `false` is set.
    pub fn stall(&self, is_stalled: bool) {
        self.shared.is_stalled.send_replace(is_stalled);
    }

    /// Sends new connections to another device.
    pub fn retarget(&self, target: SocketAddr) {
        *self.shared.target.lock().unwrap() = target;
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        let connections = std::mem::take(&mut *self.shared.connections.lock().unwrap());
        for task in connections.into_iter().chain(self.accepting.take()) {
            task.abort();
        }
    }
}

async fn end(task: Option<JoinHandle<()>>) {
    if let Some(task) = task {
        task.abort();
        // The task closes its sockets only once it has ended.
        let _ = task.await;
    }
}

fn reusing(address: SocketAddr) -> TcpSocket {
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_reuseaddr(true).unwrap();
    socket.bind(address).unwrap();
    socket
}

async fn accept(listener: TcpListener, shared: Arc<Shared>, frames: Frames) {
    loop {
        let (gateway, _) = listener.accept().await.unwrap();
        let recorder = frames.recorder(shared.accepted.fetch_add(1, Ordering::Relaxed));
        let pumping = tokio::spawn(pump(gateway, shared.clone(), recorder));
        shared.connections.lock().unwrap().push(pumping);
    }
}

async fn pump(gateway: TcpStream, shared: Arc<Shared>, recorder: Recorder) {
    let target = *shared.target.lock().unwrap();
    let Ok(device) = TcpStream::connect(target).await else { return };
    for stream in [&gateway, &device] {
        stream.set_nodelay(true).unwrap();
    }
    let (from_gateway, to_gateway) = gateway.into_split();
    let (from_device, to_device) = device.into_split();
    tokio::join!(
        forward(from_gateway, to_device, &shared, Some(recorder)),
        forward(from_device, to_gateway, &shared, None)
    );
}

/// Forwards bytes until the sender closes, then closes the receiver's side. Bytes that arrive during a stall are
/// delivered when it ends.
async fn forward(
    mut from: impl AsyncReadExt + Unpin,
    mut to: impl AsyncWriteExt + Unpin,
    shared: &Shared,
    mut recorder: Option<Recorder>,
) {
    let mut is_stalled = shared.is_stalled.subscribe();
    let (mut buffer, mut held, mut is_open) = ([0; READ_BYTES], Vec::new(), true);
    while is_open || !held.is_empty() {
        tokio::select! {
            read = from.read(&mut buffer), if is_open => {
                let bytes = read.unwrap_or(0);
                is_open = bytes > 0;
                held.extend_from_slice(&buffer[..bytes]);
                if let Some(recorder) = &mut recorder {
                    recorder.push(&buffer[..bytes]);
                }
            }
            () = flowing(&mut is_stalled), if !held.is_empty() => {
                if to.write_all(&held).await.is_err() {
                    return;
                }
                held.clear();
            }
        }
    }
    // A close must not overtake the bytes before it.
    flowing(&mut is_stalled).await;
}

async fn flowing(is_stalled: &mut watch::Receiver<bool>) {
    // An error means that the proxy is gone, so this task ends too.
    let _ = is_stalled.wait_for(|stalled| !stalled).await;
}
