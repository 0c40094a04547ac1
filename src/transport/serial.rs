//! RS-232 transport: 8 data bits, no parity, 1 or 2 stop bits; 115200 baud is common (field practice; the manuals name
//! neither).
//!
//! A FAST STOP cannot overtake bytes in the kernel's buffer, which take tens of milliseconds at 9600 baud. So a flush
//! ends only when the line has drained, and a flush after each frame keeps at most one frame in the kernel.

use std::fmt;
use std::fs;
use std::io;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use rustix::fs::{Mode, OFlags, open};
use rustix::termios::ioctl_tiocnxcl;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::runtime::Handle;
use tokio_serial::{ClearBuffer, DataBits, FlowControl, Parity, SerialPort, SerialStream, StopBits};
use url::Url;

use super::options::Options;
use super::pace::Pacer;
use super::{CONNECT_WITHIN, LinkProperties, Pipe, present};

/// Default bit rate (field practice).
const DEFAULT_BAUD: u32 = 115_200;

/// A USB adapter buffers received bytes for 16 ms, and a busy host adds to the delay.
const FRAME_GAP: Duration = Duration::from_millis(100);

/// Directory of pseudo terminals.
const PTYS: &str = "/dev/pts";

/// Shortest interval between checks whether the kernel's buffer is empty.
const MIN_CHECK_INTERVAL: Duration = Duration::from_millis(1);

/// A serial port with its line settings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SerialAddress {
    /// Device file, e.g. `/dev/ttyUSB0`. A link in `/dev/serial/by-id` stays the same if adapters swap ports.
    pub path: String,
    /// Bit rate in bits per second, 1200 to 460800; 115200 by default.
    pub baud: u32,
    /// Number of stop bits, 1 or 2; 1 by default.
    pub stop_bits: u8,
}

impl SerialAddress {
    /// Bit rates of devices (field practice).
    pub const BAUDS: [u32; 10] = [1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800];

    pub(super) fn parse(url: &Url) -> Result<Self, String> {
        let options = Options::of(url, &["baud", "stop_bits"])?;
        if url.has_host() && url.host_str().is_some_and(|host| !host.is_empty()) {
            return Err("a serial port is an absolute path: write three slashes".to_owned());
        }
        let path = decoded_path(url)?;
        if path.len() < 2 {
            return Err("the serial port is missing: expected an absolute path".to_owned());
        }
        let baud = options.one_of("baud", &Self::BAUDS)?.unwrap_or(DEFAULT_BAUD);
        let stop_bits = options.one_of("stop_bits", &[1, 2])?.unwrap_or(1) as u8;
        Ok(Self { path, baud, stop_bits })
    }

    /// Line rate: a byte takes a start bit, 8 data bits and the stop bits.
    #[must_use]
    pub const fn bytes_per_second(&self) -> u32 {
        self.baud / (1 + 8 + self.stop_bits as u32)
    }

    pub(super) const fn properties(&self) -> LinkProperties {
        LinkProperties {
            name: "serial",
            connection_oriented: false,
            bytes_per_second: Some(self.bytes_per_second()),
            may_duplicate: false,
            frame_gap: FRAME_GAP,
        }
    }

    pub(super) async fn connect(&self) -> io::Result<Pipe> {
        // Opening can block on an adapter, which must not delay other grippers.
        let address = self.clone();
        let opening = tokio::task::spawn_blocking(move || address.open());
        let opened = tokio::time::timeout(CONNECT_WITHIN, opening).await.map_err(|_| {
            let waited = CONNECT_WITHIN.as_secs();
            io::Error::new(io::ErrorKind::TimedOut, format!("{} did not open within {waited} s", self.path))
        })?;
        let stream = opened.map_err(io::Error::other)??;
        let port = Port::new(stream);
        let pacer = Pacer::new(self.bytes_per_second());
        let path: Arc<str> = self.path.as_str().into();
        let reader = Reader { port: port.clone(), path: path.clone() };
        let unsent = port.clone();
        let pipe = Pipe::new(reader, Writer { port, path, pacer });
        Ok(Pipe {
            discard_unsent: Some(Box::new(move || {
                // A port that is gone has nothing to send.
                let _ = unsent.with(|port| port.clear(ClearBuffer::Output));
            })),
            ..pipe
        })
    }

    fn open(&self) -> io::Result<SerialStream> {
        let stop_bits = if self.stop_bits == 2 { StopBits::Two } else { StopBits::One };
        let builder = tokio_serial::new(self.path.as_str(), self.baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(stop_bits)
            .flow_control(FlowControl::None);
        // Opened before the port becomes exclusive.
        let pty =
            is_pty(&self.path).then(|| open_quietly(&self.path)).transpose().map_err(|error| self.explain(&error))?;
        let stream = SerialStream::open(&builder).map_err(|error| self.explain(&error.into()))?;
        if let Some(pty) = pty {
            // A pty would stay exclusive after a SIGKILL, as long as the program at its other end runs. The lock of the
            // file (flock) is enough, and ends with this process.
            let _ = ioctl_tiocnxcl(&pty);
        }
        // Old input is half a frame at best. If clearing it fails, as on a pty, the decoder resynchronises.
        let _ = stream.clear(ClearBuffer::Input);
        Ok(stream)
    }

    fn explain(&self, error: &io::Error) -> io::Error {
        let path = &self.path;
        let busy = [io::ErrorKind::NotFound, io::ErrorKind::WouldBlock, io::ErrorKind::ResourceBusy];
        let is_busy = busy.contains(&error.kind());
        let detail = if error.kind() == io::ErrorKind::PermissionDenied {
            format!(
                "no permission to open {path} ({error}): add the gateway's user to the group of the port, usually \
                 dialout (sudo usermod -aG dialout USER), and restart the gateway"
            )
        } else if !Path::new(path).exists() {
            format!("{path} does not exist; {}", present::serial_ports())
        } else if is_busy && is_pty(path) {
            format!(
                "{path} is in use ({error}): close the other program. If none uses it, a killed program has left this pseudo \
                 terminal exclusive: restart the program that provides it, such as socat"
            )
        } else if is_busy {
            format!("{path} is in use ({error}): close the other program")
        } else {
            format!("{path} cannot be opened ({error}); {}", present::serial_ports())
        };
        io::Error::new(error.kind(), detail)
    }
}

impl fmt::Display for SerialAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}?baud={}&stop_bits={}", present::serial_url(&self.path), self.baud, self.stop_bits)
    }
}

/// Path of a URL, with percent-encoded bytes decoded. Empty if it is not absolute.
fn decoded_path(url: &Url) -> Result<String, String> {
    if !url.path().starts_with('/') {
        return Ok(String::new());
    }
    // Only for file URLs does the URL crate decode paths.
    let mut file = Url::parse("file:///").map_err(|error| error.to_string())?;
    file.set_path(url.path());
    let path = file.to_file_path().ok().and_then(|path| path.into_os_string().into_string().ok());
    let path = path.filter(|path| !path.contains('\0'));
    path.ok_or_else(|| "the path of the serial port is not UTF-8 text; percent-encode its UTF-8 bytes".to_owned())
}

/// Whether a port is a pseudo terminal.
fn is_pty(path: &str) -> bool {
    fs::canonicalize(path).is_ok_and(|path| path.starts_with(PTYS))
}

/// Opens a port without waiting for a carrier, and without making it the terminal of this process.
fn open_quietly(path: &str) -> io::Result<OwnedFd> {
    Ok(open(path, OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty())?)
}

/// An open port. Closing it can block for seconds, while an adapter sends what it still has, so a thread of its own
/// closes it.
#[derive(Clone)]
struct Port(Arc<Mutex<Closing>>);

struct Closing(Option<SerialStream>);

impl Drop for Closing {
    fn drop(&mut self) {
        if let (Some(stream), Ok(runtime)) = (self.0.take(), Handle::try_current()) {
            drop(runtime.spawn_blocking(move || drop(stream)));
        }
    }
}

impl Port {
    fn new(stream: SerialStream) -> Self {
        Self(Arc::new(Mutex::new(Closing(Some(stream)))))
    }

    /// Runs a function on the open port.
    fn with<T>(&self, run: impl FnOnce(Pin<&mut SerialStream>) -> T) -> io::Result<T> {
        // No code panics while holding the lock; even then, the port would remain usable.
        let mut port = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        port.0.as_mut().map(|stream| run(Pin::new(stream))).ok_or_else(|| io::ErrorKind::NotConnected.into())
    }
}

struct Reader {
    port: Port,
    path: Arc<str>,
}

impl AsyncRead for Reader {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = out.filled().len();
        let read = ready!(self.port.with(|port| port.poll_read(cx, out))?);
        // A serial line has no end of file.
        let is_end = read.is_ok() && out.filled().len() == before;
        let read = if is_end { Err(io::ErrorKind::UnexpectedEof.into()) } else { read };
        Poll::Ready(read.map_err(|error| gone(&self.path, &error)))
    }
}

/// Explains the I/O error that the operating system reports for an unplugged adapter.
fn gone(path: &str, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{path} is gone ({error}): check that the adapter is plugged in"))
}

struct Writer {
    port: Port,
    path: Arc<str>,
    pacer: Pacer,
}

impl AsyncWrite for Writer {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        let written = ready!(self.port.with(|port| port.poll_write(cx, frame))?);
        let written = written.map_err(|error| gone(&self.path, &error))?;
        self.pacer.wrote(written);
        Poll::Ready(Ok(written))
    }

    /// Is ready once the line has drained, by estimate and by the kernel's buffer. A pty reports an empty buffer at
    /// once, and a delayed line takes longer than estimated.
    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        loop {
            ready!(self.pacer.poll_free(cx));
            let waiting = self.port.with(|port| port.bytes_to_write())?.unwrap_or_default();
            if waiting == 0 {
                return Poll::Ready(Ok(()));
            }
            let time = self.pacer.line_time(waiting as usize).max(MIN_CHECK_INTERVAL);
            self.pacer.hold(time);
        }
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[cfg(test)]
#[path = "serial_tests.rs"]
mod tests;
