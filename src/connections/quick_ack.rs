//! A TCP stream that acknowledges data at once and moves to the runtime that serves it.
//!
//! Many clients send a request's header and body in two packets and hold the second back until the first is
//! acknowledged, which the kernel delays by 40 ms. Each such request on a kept connection would lose that time, and a
//! FAST STOP would lose its reason, for which it waits only 20 ms.
//!
//! A connection can move to another runtime, so that the traffic of a thousand observers does not wake the thread of
//! the old one.
//!
//! The server reads nothing while a request runs and bytes of the next one wait, so it does not notice the end of such
//! a connection. The stream then notices it when it is flushed.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, Interest, ReadBuf};
use tokio::net::TcpStream;
use tokio::runtime::{self, Handle};
use tokio::time::{Sleep, sleep};
use tokio_util::sync::CancellationToken;

/// Interval of looks for the end of a connection whose bytes are not read.
const LOOKS_EVERY: Duration = Duration::from_millis(100);

/// A TCP stream that acknowledges data at once and can change its runtime.
#[derive(Debug)]
pub struct QuickAckStream {
    /// `None` after a failed move, which ends the connection.
    stream: Option<TcpStream>,
    /// Runtime that the stream is registered with.
    home: runtime::Id,
    /// Whether the stream stays there, because several runtimes use it.
    is_settled: bool,
    /// Whether the server waits for bytes, and so notices the end of the connection.
    is_reading: bool,
    /// Cancelled when the client has ended the connection while the server does not read.
    gone: CancellationToken,
    /// Time of the next look, while bytes wait: the end of the connection then wakes nobody.
    look_again: Option<Pin<Box<Sleep>>>,
}

impl QuickAckStream {
    /// Wraps a stream that is registered with the caller's runtime.
    pub fn new(stream: TcpStream) -> Self {
        let home = Handle::current().id();
        let gone = CancellationToken::new();
        Self { stream: Some(stream), home, is_settled: false, is_reading: false, gone, look_again: None }
    }

    /// Token that is cancelled when the client has ended the connection while the server does not read.
    pub fn gone(&self) -> CancellationToken {
        self.gone.clone()
    }

    /// Looks for the end of a connection that the server does not read.
    fn notice_end(&mut self, cx: &mut Context<'_>) {
        if self.is_reading || self.gone.is_cancelled() {
            return;
        }
        let Ok(stream) = self.stream() else { return };
        let ready = std::pin::pin!(stream.ready(Interest::READABLE)).poll(cx);
        // The future above no longer wakes the task.
        let _ = stream.poll_read_ready(cx);
        match ready {
            Poll::Ready(Ok(ready)) if ready.is_read_closed() => self.gone.cancel(),
            Poll::Ready(_) => {
                let mut look_again = Box::pin(sleep(LOOKS_EVERY));
                // Pending, since it was just set.
                let _ = look_again.as_mut().poll(cx);
                self.look_again = Some(look_again);
            }
            Poll::Pending => self.look_again = None,
        }
    }

    /// Returns the stream, registered with the caller's runtime.
    fn stream(&mut self) -> io::Result<Pin<&mut TcpStream>> {
        let here = Handle::current().id();
        if self.home != here && !self.is_settled {
            let moved = self.stream.take().map(|stream| TcpStream::from_std(stream.into_std()?));
            self.stream = moved.transpose()?;
            self.home = here;
        }
        self.stream.as_mut().map(Pin::new).ok_or_else(|| io::ErrorKind::NotConnected.into())
    }
}

/// Requests an immediate acknowledgement. The kernel resets this option by itself, so it is set after each read.
#[cfg_attr(not(target_os = "linux"), expect(unused_variables, reason = "only Linux has this option"))]
fn acknowledge(stream: &TcpStream) {
    #[cfg(target_os = "linux")]
    let _ = socket2::SockRef::from(stream).set_tcp_quickack(true);
}

impl QuickAckStream {
    /// Moves the stream to a runtime, where it stays.
    ///
    /// # Errors
    /// The stream cannot be moved.
    pub fn settle(&mut self, runtime: &Handle) -> io::Result<()> {
        let _inside = runtime.enter();
        self.stream()?;
        self.is_settled = true;
        Ok(())
    }

    /// Returns the inner stream, or an error if a move has failed.
    pub fn into_inner(self) -> io::Result<TcpStream> {
        self.stream.ok_or_else(|| io::ErrorKind::NotConnected.into())
    }
}

impl AsyncRead for QuickAckStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let mut stream = self.stream()?;
        let read = stream.as_mut().poll_read(cx, buffer);
        if read.is_ready() {
            acknowledge(&stream);
        }
        self.is_reading = read.is_pending();
        read
    }
}

impl AsyncWrite for QuickAckStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.stream()?.poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.notice_end(cx);
        self.stream()?.poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream()?.poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffers: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.stream()?.poll_write_vectored(cx, buffers)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.as_ref().is_some_and(AsyncWrite::is_write_vectored)
    }
}
