//! The two halves of a client's connection, each used by its own runtime. Reading can bring a FAST STOP, so it must not
//! wait for the thread that writes to a thousand observers. The second half of a TCP connection takes a second
//! descriptor. The halves of an encrypted connection share their state, and stay with the reading runtime.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use bytes::Bytes;
use tokio::io::{self as streams, AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::runtime::Handle;
use tokio_util::either::Either;

use super::outbox::Outbox;
use crate::connections::admission::HeldBytes;
use crate::connections::client_stream::{ClientStream, EncryptedStream};

/// The half for reading.
pub type ReadingHalf = Either<TcpStream, streams::ReadHalf<Box<EncryptedStream>>>;

/// The half for writing.
pub type WritingHalf = Either<TcpStream, streams::WriteHalf<Box<EncryptedStream>>>;

/// Splits a connection into a half for reading and a half for writing, each for its own runtime.
pub fn split(stream: ClientStream, reader: &Handle, writer: &Handle) -> io::Result<(ReadingHalf, WritingHalf)> {
    match stream {
        Either::Left(stream) => {
            let stream = stream.into_inner()?.into_std()?;
            let clone = stream.try_clone()?;
            Ok((Either::Left(registered(stream, reader)?), Either::Left(registered(clone, writer)?)))
        }
        Either::Right(mut stream) => {
            stream.below().settle(reader)?;
            let (reading, writing) = streams::split(stream);
            Ok((Either::Right(reading), Either::Right(writing)))
        }
    }
}

fn registered(stream: std::net::TcpStream, runtime: &Handle) -> io::Result<TcpStream> {
    let _inside = runtime.enter();
    TcpStream::from_std(stream)
}

/// The stream below the WebSocket protocol: reads come from the reading half, and its own frames (pongs) go to the
/// outbox.
#[derive(Debug)]
pub struct Inbound {
    /// Bytes that arrived in the handshake's last packet.
    early: Bytes,
    half: ReadingHalf,
    outbox: Arc<Outbox>,
    /// Bytes of the incomplete message.
    incomplete: usize,
    /// Reads since other clients had a turn.
    reads: u8,
    held: Option<HeldBytes>,
}

/// Reads before another client's turn, so that a client that sends only small frames can't delay the FAST STOPs of
/// others.
const READS_A_TURN: u8 = 2;

/// Granularity of the count of held bytes; smaller messages are not counted.
const COUNTED_FROM: usize = 8 * 1024;

impl Inbound {
    pub fn new(early: Bytes, half: ReadingHalf, outbox: Arc<Outbox>, held: Option<HeldBytes>) -> Self {
        Self { early, half, outbox, incomplete: 0, reads: 0, held }
    }

    /// Marks a message as processed, so that its bytes no longer count.
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
        let early = self.early.len().min(before);
        buffer.put_slice(&self.early.split_to(early));
        if early == 0 {
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
