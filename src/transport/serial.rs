//! RS-232: 8 data bits, no parity, 1 or 2 stop bits; 115200 baud is common (field practice: the manuals name neither).
//!
//! A slow line makes latency: what lies in the kernel's buffer can't be overtaken any more, at 9600 baud not for tens
//! of milliseconds. So the writer's flush ends only when the line has drained, and whoever flushes after each frame
//! never has more than one in the kernel.

use std::fmt;
use std::io;
use std::path::Path;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio_serial::{ClearBuffer, DataBits, FlowControl, Parity, SerialPort, SerialStream, StopBits};
use url::Url;

use super::options::Options;
use super::pace::Pacer;
use super::{CONNECT_WITHIN, LinkProperties, Pipe, present};

/// The bit rate unless it is said (field practice).
const DEFAULT_BAUD: u32 = 115_200;

/// The bit rates that devices have (field practice).
const BAUDS: [u32; 10] = [1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800];

/// A USB adapter gathers what it receives for 16 ms, and a busy host adds to that.
const FRAME_GAP: Duration = Duration::from_millis(100);

/// How often the kernel is asked whether its buffer is empty, once it should be.
const DRAINS_WITHIN: Duration = Duration::from_millis(1);

/// A serial port and how its device is set up.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SerialAddress {
    /// E.g. `/dev/ttyUSB0`. A link in `/dev/serial/by-id` stays the same when adapters change places.
    pub path: String,
    /// Bits per second, 1200 to 460800; 115200 by default.
    pub baud: u32,
    /// 1 or 2; 1 by default.
    pub stop_bits: u8,
}

impl SerialAddress {
    pub(super) fn parse(url: &Url) -> Result<Self, String> {
        let options = Options::of(url, &["baud", "stop_bits"])?;
        if url.has_host() && url.host_str().is_some_and(|host| !host.is_empty()) {
            return Err("a serial port is a path: with three slashes it begins at the root".to_owned());
        }
        let path = url.path();
        if !path.starts_with('/') || path.len() < 2 || path.contains('%') {
            return Err("it names no port: a path from the root, without special characters".to_owned());
        }
        let baud = options.one_of("baud", &BAUDS)?.unwrap_or(DEFAULT_BAUD);
        let stop_bits = options.one_of("stop_bits", &[1, 2])?.unwrap_or(1) as u8;
        Ok(Self { path: path.to_owned(), baud, stop_bits })
    }

    /// How fast its line is: a start bit, 8 data bits and the stop bits make a byte.
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
        // Opening may wait for an adapter, which must not hold up the other grippers.
        let address = self.clone();
        let opening = tokio::task::spawn_blocking(move || address.open());
        let opened = tokio::time::timeout(CONNECT_WITHIN, opening).await.map_err(|_| {
            let waited = CONNECT_WITHIN.as_secs();
            io::Error::new(io::ErrorKind::TimedOut, format!("{} did not open within {waited} s", self.path))
        })?;
        let stream = opened.map_err(io::Error::other)??;
        let port = Arc::new(Mutex::new(stream));
        let pacer = Pacer::new(self.bytes_per_second());
        let path: Arc<str> = self.path.as_str().into();
        let reader = Reader { port: port.clone(), path: path.clone() };
        Ok(Pipe { reader: Box::new(reader), writer: Box::new(Writer { port, path, pacer }) })
    }

    fn open(&self) -> io::Result<SerialStream> {
        let stop_bits = if self.stop_bits == 2 { StopBits::Two } else { StopBits::One };
        let builder = tokio_serial::new(self.path.as_str(), self.baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(stop_bits)
            .flow_control(FlowControl::None);
        let stream = SerialStream::open(&builder).map_err(|error| self.explain(&error.into()))?;
        // What came before is half a frame at best. A pty can't say; then it is resynchronised.
        let _ = stream.clear(ClearBuffer::Input);
        Ok(stream)
    }

    fn explain(&self, error: &io::Error) -> io::Error {
        let path = &self.path;
        let detail = if error.kind() == io::ErrorKind::PermissionDenied {
            format!(
                "{path} may not be opened ({error}): add the user that the gateway runs as to the group that owns it, \
                 mostly dialout: sudo usermod -aG dialout USER, and start the gateway again"
            )
        } else if !Path::new(path).exists() {
            format!("{path} is not there; {}", present::serial_ports())
        } else if error.kind() == io::ErrorKind::NotFound || error.kind() == io::ErrorKind::WouldBlock {
            format!("{path} is in use ({error}): end the other program that has it open")
        } else {
            format!("{path} cannot be opened ({error}); {}", present::serial_ports())
        };
        io::Error::new(error.kind(), detail)
    }
}

impl fmt::Display for SerialAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "serial://{}?baud={}&stop_bits={}", self.path, self.baud, self.stop_bits)
    }
}

type Port = Arc<Mutex<SerialStream>>;

fn locked(port: &Port) -> MutexGuard<'_, SerialStream> {
    // Nothing panics while it holds the lock; if it did, the port would still be a port.
    port.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Reader {
    port: Port,
    path: Arc<str>,
}

impl AsyncRead for Reader {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = out.filled().len();
        let read = ready!(Pin::new(&mut *locked(&self.port)).poll_read(cx, out));
        // A serial line has no end of file.
        let is_end = read.is_ok() && out.filled().len() == before;
        let read = if is_end { Err(io::ErrorKind::UnexpectedEof.into()) } else { read };
        Poll::Ready(read.map_err(|error| gone(&self.path, &error)))
    }
}

/// The operating system's word for an adapter that was pulled is an error of input or output.
fn gone(path: &str, error: &io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{path} is gone ({error}): was its adapter pulled?"))
}

struct Writer {
    port: Port,
    path: Arc<str>,
    pacer: Pacer,
}

impl AsyncWrite for Writer {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        let written = ready!(Pin::new(&mut *locked(&self.port)).poll_write(cx, frame));
        let written = written.map_err(|error| gone(&self.path, &error))?;
        self.pacer.wrote(written);
        Poll::Ready(Ok(written))
    }

    /// Ready once the line has drained. Both ways of knowing are needed: a pty says at once that its buffer is empty,
    /// and a line that is held up takes longer than reckoned.
    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        loop {
            ready!(self.pacer.poll_free(cx));
            let waiting = locked(&self.port).bytes_to_write().unwrap_or_default();
            if waiting == 0 {
                return Poll::Ready(Ok(()));
            }
            let time = self.pacer.line_time(waiting as usize).max(DRAINS_WITHIN);
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
