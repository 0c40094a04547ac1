//! The two halves of a client's TCP connection, each registered with a runtime of its own: reading, which may bring a FAST
//! STOP, must not wait for the thread that writes to a thousand observers. That takes a second descriptor.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use bytes::Bytes;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::runtime::Handle;

use super::outbox::Outbox;
use crate::interfaces::admission::HeldBytes;

/// Splits a connection into what is read on the one runtime and written on the other.
///
/// # Errors
/// As the operating system says.
pub fn split(stream: TcpStream, reader: &Handle, writer: &Handle) -> io::Result<(TcpStream, TcpStream)> {
    let stream = stream.into_std()?;
    let clone = stream.try_clone()?;
    Ok((registered(stream, reader)?, registered(clone, writer)?))
}

fn registered(stream: std::net::TcpStream, runtime: &Handle) -> io::Result<TcpStream> {
    let _inside = runtime.enter();
    TcpStream::from_std(stream)
}

/// The stream below the WebSocket protocol: reads come from the reading half, and its own frames (pongs) go to the outbox.
#[derive(Debug)]
pub struct Inbound {
    /// Bytes that came in the handshake's last packet.
    early: io::Cursor<Bytes>,
    half: TcpStream,
    outbox: Arc<Outbox>,
    /// Bytes of the message that is not complete yet.
    incomplete: usize,
    /// Reads since others had a turn.
    reads: u8,
    held: Option<HeldBytes>,
}

/// Reads until it is another client's turn. One that sends nothing but small frames would hold up the FAST STOPs of others.
const READS_A_TURN: u8 = 2;

/// How exact the count of held bytes is: messages below this are not worth counting.
const COUNTED_FROM: usize = 8 * 1024;

impl Inbound {
    pub fn new(early: Bytes, half: TcpStream, outbox: Arc<Outbox>, held: Option<HeldBytes>) -> Self {
        Self { early: io::Cursor::new(early), half, outbox, incomplete: 0, reads: 0, held }
    }

    /// Marks that a message has been taken, with all that it held.
    pub fn taken(&mut self) {
        self.incomplete = 0;
        self.count();
    }

    fn count(&mut self) {
        let bytes = self.incomplete / COUNTED_FROM * COUNTED_FROM;
        if let Some(held) = self.held.as_mut().filter(|held| held.bytes() != bytes) {
            held.set(bytes);
        }
    }
}

impl AsyncRead for Inbound {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.reads += 1;
        if self.reads > READS_A_TURN {
            self.reads = 0;
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let before = buffer.remaining();
        ready!(Pin::new(&mut self.early).poll_read(context, buffer))?;
        if buffer.remaining() == before {
            ready!(Pin::new(&mut self.half).poll_read(context, buffer))?;
        }
        self.incomplete += before - buffer.remaining();
        self.count();
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Inbound {
    fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, frames: &[u8]) -> Poll<io::Result<usize>> {
        self.outbox.push(Bytes::copy_from_slice(frames));
        Poll::Ready(Ok(frames.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}
