//! CAN transport: classic data frames with 11-bit ids, one for requests and one for replies; see [`segment`] for their
//! contents. The bit rate, usually 500 or 1000 kbit/s, is set on the device and on the interface (field practice).

pub mod segment;

use std::collections::VecDeque;
use std::fmt;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use futures_util::Stream;
use rustix::io::Errno;
use socketcan::tokio::CanSocket;
use socketcan::{CanFilter, CanFrame, EmbeddedFrame, SocketOptions, StandardId};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Interval, MissedTickBehavior, Sleep, interval, sleep};
use url::Url;

use super::options::Options;
use super::pace::Pacer;
use super::{LinkProperties, Pipe, present};
use segment::Reassembler;

/// Default ids: the most common pair (field practice).
const DEFAULT_TX: u16 = 0x64;
const DEFAULT_RX: u16 = 0x65;

/// Default bit rate: the slower of the two common ones, so that the line rate is never overestimated.
const DEFAULT_BITRATE: u32 = 500_000;

const MAX_ID: u32 = 0x7FF;

/// Bits on the bus per payload byte. A slice of 8 bytes takes up to 135 bits including stuffing and gap, and holds 6.7
/// bytes on average.
const BITS_PER_BYTE: u32 = 21;

/// Slices of a frame follow each other directly, except for frames of higher priority in between.
const FRAME_GAP: Duration = Duration::from_millis(100);

/// Poll interval of the interface, because a pending read is not notified when the interface goes down.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Retry delay when the kernel's queue is full: about ten frames at the common bit rates.
const QUEUE_FULL: Duration = Duration::from_millis(1);

/// Error frame bit for a controller that has left the bus (`CAN_ERR_BUSOFF`).
const BUS_OFF: u32 = 0x40;

/// Filter mask for all 11 id bits and the flags of extended and remote frames. With the flag of error frames, the
/// filter would match only those.
const WHOLE_ID: u32 = 0xC000_07FF;

/// A device on a CAN bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CanAddress {
    /// Network interface, e.g. `can0`.
    pub interface: String,
    /// 11-bit id of requests, 64h by default.
    pub tx: u16,
    /// 11-bit id of replies, 65h by default.
    pub rx: u16,
    /// Bit rate in bits per second, 10000 to 1000000; 500000 by default. Only for estimates: the interface sets it.
    pub bitrate: u32,
}

impl CanAddress {
    /// Options in a URL.
    pub const OPTIONS: [&str; 3] = ["tx", "rx", "bitrate"];

    pub(super) fn parse(url: &Url) -> Result<Self, String> {
        let options = Options::of(url, &Self::OPTIONS)?;
        let interface = url.host_str().unwrap_or_default();
        // IFNAMSIZ, including the terminating NUL.
        if interface.is_empty() || interface.len() > 15 || !matches!(url.path(), "" | "/") || url.port().is_some() {
            return Err("the interface is missing or invalid: expected a name such as can0".to_owned());
        }
        let tx = options.number("tx", 0..=MAX_ID)?.map_or(DEFAULT_TX, |id| id as u16);
        let rx = options.number("rx", 0..=MAX_ID)?.map_or(DEFAULT_RX, |id| id as u16);
        if tx == rx {
            return Err(format!("tx and rx are both {tx:#x}: requests and replies need different ids"));
        }
        let bitrate = options.number("bitrate", 10_000..=1_000_000)?.unwrap_or(DEFAULT_BITRATE);
        Ok(Self { interface: interface.to_owned(), tx, rx, bitrate })
    }

    /// Reason and remedy if the two devices share an id.
    pub(super) fn conflict_with(&self, other: &Self) -> Option<String> {
        let ids = [other.tx, other.rx];
        let shared = [self.tx, self.rx].into_iter().find(|id| ids.contains(id))?;
        (self.interface == other.interface).then(|| {
            let interface = &self.interface;
            format!("both use the id {shared:#x} on {interface}: use separate tx and rx ids, also on the device")
        })
    }

    /// Lower bound of the line rate.
    #[must_use]
    pub const fn bytes_per_second(&self) -> u32 {
        self.bitrate / BITS_PER_BYTE
    }

    pub(super) const fn properties(&self) -> LinkProperties {
        LinkProperties {
            name: "can",
            connection_oriented: false,
            bytes_per_second: Some(self.bytes_per_second()),
            may_duplicate: false,
            frame_gap: FRAME_GAP,
        }
    }

    pub(super) fn connect(&self) -> io::Result<Pipe> {
        let (listening, sending) = self.open().map_err(|error| self.explain(&error))?;
        // Opening succeeds even if the interface is down, but no frames pass.
        if present::is_can(&self.interface) && !present::is_up(&self.interface) {
            let remedy = self.bring_up(present::is_virtual(&self.interface));
            let detail = format!("{} is down: bring it up with {remedy}", self.interface);
            return Err(io::Error::new(io::ErrorKind::NetworkDown, detail));
        }
        let id = StandardId::new(self.tx).ok_or(io::ErrorKind::InvalidInput)?;
        let mut look = interval(LOOK_EVERY);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let interface = self.interface.clone();
        let reassembler = Reassembler::default();
        let reader = Reader { interface, socket: listening, look, reassembler, bytes: VecDeque::new() };
        let pacer = Pacer::new(self.bytes_per_second());
        let writer =
            Writer { socket: sending, id, queue: VecDeque::new(), sent: None, has_begun: false, limit: None, pacer };
        Ok(Pipe::new(reader, writer))
    }

    /// Command that brings the interface up. Virtual interfaces reject a bit rate.
    fn bring_up(&self, is_virtual: bool) -> String {
        let Self { interface, bitrate, .. } = self;
        let settings = if is_virtual { String::new() } else { format!(" type can bitrate {bitrate} restart-ms 100") };
        format!("sudo ip link set {interface} up{settings}")
    }

    /// Opens separate sockets for listening and sending, so that they share no state. The sending one receives only its
    /// own frames, once they were sent.
    fn open(&self) -> io::Result<(CanSocket, CanSocket)> {
        let listening = CanSocket::open(&self.interface)?;
        let sending = CanSocket::open(&self.interface)?;
        listening.set_filters(&[CanFilter::new(self.rx.into(), WHOLE_ID)])?;
        listening.set_error_filter(BUS_OFF)?;
        sending.set_filters(&[CanFilter::new(self.tx.into(), WHOLE_ID)])?;
        sending.set_recv_own_msgs(true)?;
        Ok((listening, sending))
    }

    fn explain(&self, error: &io::Error) -> io::Error {
        let interface = &self.interface;
        let remedy = match Errno::from_io_error(error) {
            Some(Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT) => {
                "CAN sockets are not available: run sudo modprobe can-raw, or allow AF_CAN if the service is sandboxed"
                    .to_owned()
            }
            Some(Errno::PERM | Errno::ACCESS) => {
                "CAN sockets are not permitted: use the host's network in a container, or allow AF_CAN in a sandbox"
                    .to_owned()
            }
            _ => present::can_interfaces(),
        };
        io::Error::new(error.kind(), format!("{interface} cannot be opened ({error}): {remedy}"))
    }
}

impl fmt::Display for CanAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { interface, tx, rx, bitrate } = self;
        write!(f, "can://{interface}?tx={tx:#x}&rx={rx:#x}")?;
        if *bitrate == DEFAULT_BITRATE { Ok(()) } else { write!(f, "&bitrate={bitrate}") }
    }
}

/// Error of a controller without automatic restart: it stays off the bus and reports that once. The remedy first takes
/// the interface down, because `restart-ms` can only be set then.
fn bus_off(interface: &str) -> io::Error {
    let detail = format!(
        "{interface} is bus-off: its bit rate differs from the device's, or the cable is faulty. Enable automatic \
         restart: sudo ip link set {interface} down; sudo ip link set {interface} type can restart-ms 100; \
         sudo ip link set {interface} up"
    );
    io::Error::new(io::ErrorKind::NetworkDown, detail)
}

struct Reader {
    interface: String,
    socket: CanSocket,
    look: Interval,
    reassembler: Reassembler,
    /// Bytes received but not yet read.
    bytes: VecDeque<u8>,
}

impl Reader {
    fn take(&mut self, frame: &CanFrame) -> io::Result<()> {
        match frame {
            CanFrame::Data(data) => self.bytes.extend(self.reassembler.push(data.data())),
            CanFrame::Error(error) if error.error_bits() & BUS_OFF != 0 => {
                return Err(bus_off(&self.interface));
            }
            CanFrame::Remote(_) | CanFrame::Error(_) => {}
        }
        Ok(())
    }

    /// Polls the socket for a frame or error without notification.
    fn look(&mut self) -> io::Result<()> {
        match self.socket.try_read_frame() {
            Ok(frame) => self.take(&frame),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
            Err(error) => Err(error),
        }
    }
}

impl AsyncRead for Reader {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        while this.bytes.is_empty() {
            if let Poll::Ready(received) = Pin::new(&mut this.socket).poll_next(cx) {
                match received {
                    Some(Ok(frame)) => this.take(&frame)?,
                    Some(Err(socketcan::Error::Io(error))) => return Poll::Ready(Err(error)),
                    Some(Err(error)) => return Poll::Ready(Err(io::Error::other(error))),
                    None => return Poll::Ready(Err(io::ErrorKind::UnexpectedEof.into())),
                }
                continue;
            }
            ready!(this.look.poll_tick(cx));
            this.look()?;
        }
        let count = this.bytes.len().min(out.remaining());
        let bytes: Vec<u8> = this.bytes.drain(..count).collect();
        out.put_slice(&bytes);
        Poll::Ready(Ok(()))
    }
}

/// Time limit for the kernel to report a frame as sent, besides its line time. It is shorter than the time limit of a
/// request, so that no motion follows after it was given up and a Stop behind it was refused.
const SENT_WITHIN: Duration = Duration::from_millis(500);

/// Sends each write as one frame, which starts in a new slice.
///
/// Without another node that acknowledges it, a controller repeats a slice for ever, even after the link was closed. So
/// each slice waits until the one before was sent. Then no whole motion is repeated once the cable is plugged in again.
struct Writer {
    socket: CanSocket,
    id: StandardId,
    /// Slices of the current frame that the kernel does not have yet.
    queue: VecDeque<CanFrame>,
    /// The slice that the kernel has, until it reports it as sent.
    sent: Option<CanFrame>,
    /// Whether the current frame has begun.
    has_begun: bool,
    /// Time limit of the current frame.
    limit: Option<Pin<Box<Sleep>>>,
    pacer: Pacer,
}

impl Writer {
    /// Waits until the kernel has no slice.
    fn poll_sent(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        while let Some(sent) = self.sent {
            let frame = match Pin::new(&mut self.socket).poll_next(cx) {
                Poll::Ready(Some(Ok(frame))) => frame,
                Poll::Ready(Some(Err(socketcan::Error::Io(error)))) => return Poll::Ready(Err(error)),
                Poll::Ready(Some(Err(error))) => return Poll::Ready(Err(io::Error::other(error))),
                Poll::Ready(None) => return Poll::Ready(Err(io::ErrorKind::UnexpectedEof.into())),
                // After a stall of the gateway, the report can be waiting although the time is over.
                Poll::Pending => match self.check_limit(cx) {
                    Ok(()) => return Poll::Pending,
                    Err(late) => match self.socket.try_read_frame() {
                        Ok(frame) => frame,
                        Err(_) => return Poll::Ready(Err(late)),
                    },
                },
            };
            // Another program can send with the same id.
            if frame.data() == sent.data() {
                self.sent = None;
            }
        }
        Poll::Ready(Ok(()))
    }

    /// Fails if the current frame is late.
    fn check_limit(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        // After a stall, the timer can be behind the clock.
        let is_late =
            |limit: &mut Pin<Box<Sleep>>| limit.as_mut().poll(cx).is_ready() || limit.deadline() <= Instant::now();
        if !self.limit.as_mut().is_some_and(is_late) {
            return Ok(());
        }
        let detail = format!("a frame was not sent within {} ms: check cable and bit rate", SENT_WITHIN.as_millis());
        Err(io::Error::new(io::ErrorKind::TimedOut, detail))
    }
}

impl AsyncWrite for Writer {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        ready!(self.as_mut().poll_flush(cx))?;
        let id = self.id;
        let slices = segment::slices(frame).filter_map(|slice| CanFrame::new(id, slice));
        self.queue.extend(slices);
        self.limit = Some(Box::pin(sleep(SENT_WITHIN + self.pacer.line_time(frame.len()))));
        Poll::Ready(Ok(frame.len()))
    }

    /// Is ready once all slices were sent, and have had their time on the line.
    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        loop {
            ready!(this.poll_sent(cx))?;
            let Some(slice) = this.queue.front().copied() else { break };
            // A motion must not continue late. A frame of one slice, such as a FAST STOP, is sent even after a stall.
            if this.has_begun {
                this.check_limit(cx)?;
            }
            // Frames of other programs with the same id must not fill the buffer.
            while this.socket.try_read_frame().is_ok() {}
            match this.socket.try_write_frame(slice) {
                Ok(()) => {
                    this.pacer.wrote(slice.dlc());
                    this.sent = this.queue.pop_front();
                    this.has_begun = true;
                }
                Err(error) if is_full(&error) => {
                    this.check_limit(cx)?;
                    this.pacer.hold(QUEUE_FULL);
                    ready!(this.pacer.poll_free(cx));
                }
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
        (this.has_begun, this.limit) = (false, None);
        this.pacer.poll_free(cx).map(Ok)
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

/// Whether the kernel's queue is full.
fn is_full(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::WouldBlock || error.raw_os_error() == Some(Errno::NOBUFS.raw_os_error())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_interface_is_brought_up_without_bit_rate() {
        let address = |name: &str| CanAddress { interface: name.to_owned(), tx: 1, rx: 2, bitrate: 250_000 };
        let real = "sudo ip link set can0 up type can bitrate 250000 restart-ms 100";
        assert_eq!(address("can0").bring_up(false), real);
        assert_eq!(address("vcan0").bring_up(true), "sudo ip link set vcan0 up");
    }

    #[test]
    fn bus_off_error_names_restart_setting() {
        let error = bus_off("can0").to_string();
        assert!(error.contains("can0 is bus-off"), "{error}");
        assert!(error.contains("ip link set can0 type can restart-ms 100"), "{error}");
    }
}
