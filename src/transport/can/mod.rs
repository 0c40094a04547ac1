//! CAN: classic data frames with 11-bit ids, requests by one id, answers by another; see [`segment`] for what is in
//! them. The bit rate, 500 or 1000 kbit/s as a rule, is set on the device and on the interface (field practice).

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
use tokio::time::{Interval, MissedTickBehavior, interval};
use url::Url;

use super::options::Options;
use super::pace::Pacer;
use super::{LinkProperties, Pipe, present};
use segment::Reassembler;

/// The ids unless they are said: the most common pair (field practice).
const DEFAULT_TX: u16 = 0x64;
const DEFAULT_RX: u16 = 0x65;

/// The bit rate unless it is said: the slower one of the two that are common, so that the line is never overrated.
const DEFAULT_BITRATE: u32 = 500_000;

/// The highest 11-bit id.
const MAX_ID: u32 = 0x7FF;

/// The bits on the bus for each of our bytes: a slice of 8 takes up to 135 with stuffing and the gap to the next, and
/// frames are cut so that it holds 6.7 bytes on average.
const BITS_PER_BYTE: u32 = 21;

/// The slices of a frame come one behind the other, but frames of higher priority may come between.
const FRAME_GAP: Duration = Duration::from_millis(100);

/// How often the interface is looked at: a read that waits isn't told that it went down.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// How long the kernel's queue is left alone when it is full: about ten frames at the common bit rates.
const QUEUE_FULL: Duration = Duration::from_millis(1);

/// An error frame's bit that says that the controller has left the bus (`CAN_ERR_BUSOFF`).
const BUS_OFF: u32 = 0x40;

/// An identifier's bits, with the flags of extended and remote frames, for a filter. The flag of error frames would make
/// it a filter for those alone.
const WHOLE_ID: u32 = 0xC000_07FF;

/// A device on a CAN bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CanAddress {
    /// The interface, e.g. `can0`.
    pub interface: String,
    /// The 11-bit id that we send with; 64h by default.
    pub tx: u16,
    /// The 11-bit id that we listen to; 65h by default.
    pub rx: u16,
    /// In bits per second, 10000 to 1000000; 500000 by default. It is the interface's, and only reckoned with here.
    pub bitrate: u32,
}

impl CanAddress {
    pub(super) fn parse(url: &Url) -> Result<Self, String> {
        let options = Options::of(url, &["tx", "rx", "bitrate"])?;
        let interface = url.host_str().unwrap_or_default();
        // IFNAMSIZ, with its end.
        if interface.is_empty() || interface.len() > 15 || !matches!(url.path(), "" | "/") || url.port().is_some() {
            return Err("it names no interface, as can0 is one".to_owned());
        }
        let id = |name, default| Ok::<_, String>(options.number(name, 0..=MAX_ID)?.map_or(default, |id| id as u16));
        let (tx, rx) = (id("tx", DEFAULT_TX)?, id("rx", DEFAULT_RX)?);
        if tx == rx {
            return Err(format!("tx and rx are both {tx:#x}: requests use one id, answers another"));
        }
        let bitrate = options.number("bitrate", 10_000..=1_000_000)?.unwrap_or(DEFAULT_BITRATE);
        Ok(Self { interface: interface.to_owned(), tx, rx, bitrate })
    }

    /// Why the devices at both can't be told apart, if they can't.
    pub(super) fn conflict_with(&self, other: &Self) -> Option<String> {
        let ids = [other.tx, other.rx];
        let shared = [self.tx, self.rx].into_iter().find(|id| ids.contains(id))?;
        (self.interface == other.interface).then(|| {
            let interface = &self.interface;
            format!("both use the id {shared:#x} on {interface}: give each a tx and an rx of its own, as on the device")
        })
    }

    /// What of our bytes the bus carries at least.
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
        // Opening an interface that is down succeeds, and then nothing happens.
        if present::is_can(&self.interface) && !present::is_up(&self.interface) {
            let remedy = self.bring_up(present::is_virtual(&self.interface));
            let detail = format!("{} is down: bring it up: {remedy}", self.interface);
            return Err(io::Error::new(io::ErrorKind::NetworkDown, detail));
        }
        let id = StandardId::new(self.tx).ok_or(io::ErrorKind::InvalidInput)?;
        let mut look = interval(LOOK_EVERY);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let interface = self.interface.clone();
        let reassembler = Reassembler::default();
        let reader = Reader { interface, socket: listening, look, reassembler, bytes: VecDeque::new() };
        let pacer = Pacer::new(self.bytes_per_second());
        Ok(Pipe {
            reader: Box::new(reader),
            writer: Box::new(Writer { socket: sending, id, queue: VecDeque::new(), pacer }),
        })
    }

    /// A virtual interface has no bit rate, and refuses one.
    fn bring_up(&self, is_virtual: bool) -> String {
        let Self { interface, bitrate, .. } = self;
        let settings = if is_virtual { String::new() } else { format!(" type can bitrate {bitrate} restart-ms 100") };
        format!("sudo ip link set {interface} up{settings}")
    }

    /// One socket to listen, and one to send, so that neither shares anything with the other.
    fn open(&self) -> io::Result<(CanSocket, CanSocket)> {
        let (listening, sending) = (CanSocket::open(&self.interface)?, CanSocket::open(&self.interface)?);
        listening.set_filters(&[CanFilter::new(self.rx.into(), WHOLE_ID)])?;
        listening.set_error_filter(BUS_OFF)?;
        sending.set_filter_drop_all()?;
        Ok((listening, sending))
    }

    fn explain(&self, error: &io::Error) -> io::Error {
        let interface = &self.interface;
        let is = |errno: Errno| error.raw_os_error() == Some(errno.raw_os_error());
        let remedy = if is(Errno::AFNOSUPPORT) || is(Errno::PROTONOSUPPORT) {
            "this system has no CAN sockets: load them with sudo modprobe can-raw, or allow AF_CAN where the service \
             is confined"
                .to_owned()
        } else if is(Errno::PERM) || is(Errno::ACCESS) {
            "CAN sockets are not allowed: a container needs the host's network, a confined service AF_CAN".to_owned()
        } else {
            present::can_interfaces()
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

/// A controller that is not told to restart stays off the bus, and says so once. It only takes that setting while down.
fn bus_off(interface: &str) -> io::Error {
    let detail = format!(
        "{interface} is bus-off: its bit rate is not the device's, or the cable is bad. Let it restart by itself: sudo ip \
         link set {interface} down; sudo ip link set {interface} type can restart-ms 100; sudo ip link set {interface} up"
    );
    io::Error::new(io::ErrorKind::NetworkDown, detail)
}

/// What the device sends.
struct Reader {
    interface: String,
    socket: CanSocket,
    look: Interval,
    reassembler: Reassembler,
    /// What was received, and not yet read.
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

    /// Whether something came, though nobody was told.
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

/// What the device is sent: a write is a frame, which begins with a slice of its own.
struct Writer {
    socket: CanSocket,
    id: StandardId,
    /// The slices of the frame that is being sent.
    queue: VecDeque<CanFrame>,
    pacer: Pacer,
}

impl AsyncWrite for Writer {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, frame: &[u8]) -> Poll<io::Result<usize>> {
        ready!(self.as_mut().poll_flush(cx))?;
        let id = self.id;
        let slices = segment::slices(frame).filter_map(|slice| CanFrame::new(id, slice));
        self.queue.extend(slices);
        Poll::Ready(Ok(frame.len()))
    }

    /// Ready once all slices have been handed to the controller, and it has had the time to send them.
    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        while let Some(slice) = this.queue.front() {
            match this.socket.try_write_frame(*slice) {
                Ok(()) => {
                    this.pacer.wrote(slice.dlc());
                    this.queue.pop_front();
                }
                Err(error) if is_full(&error) => {
                    this.pacer.hold(QUEUE_FULL);
                    ready!(this.pacer.poll_free(cx));
                }
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
        this.pacer.poll_free(cx).map(Ok)
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

/// Whether the kernel has no room for another frame at the moment.
fn is_full(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::WouldBlock || error.raw_os_error() == Some(Errno::NOBUFS.raw_os_error())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_virtual_interface_is_brought_up_without_a_bit_rate() {
        let address = |name: &str| CanAddress { interface: name.to_owned(), tx: 1, rx: 2, bitrate: 250_000 };
        let real = "sudo ip link set can0 up type can bitrate 250000 restart-ms 100";
        assert_eq!(address("can0").bring_up(false), real);
        assert_eq!(address("vcan0").bring_up(true), "sudo ip link set vcan0 up");
    }

    #[test]
    fn bus_off_is_named_with_the_setting_that_ends_it() {
        let error = bus_off("can0").to_string();
        assert!(error.contains("can0 is bus-off"), "{error}");
        assert!(error.contains("ip link set can0 type can restart-ms 100"), "{error}");
    }
}
