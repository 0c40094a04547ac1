//! A connection whose data are acknowledged at once, and that follows the runtime that serves it.
//!
//! Many clients send a request's header and its body in two packets, and hold the second back until the first one is
//! acknowledged, which the kernel delays by 40 ms. Each such request on a kept connection would lose that time, a FAST
//! STOP's reason among them.
//!
//! A connection may move to another runtime: the thread of the old one must not be woken by the traffic of a
//! thousand observers.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::runtime::{self, Handle};

/// The stream of one connection.
#[derive(Debug)]
pub struct QuickAckStream {
    /// `None` after a move that failed, which ends the connection.
    stream: Option<TcpStream>,
    /// The runtime that the stream is registered with.
    home: runtime::Id,
}

impl QuickAckStream {
    /// A connection that the caller's runtime has accepted.
    pub fn new(stream: TcpStream) -> Self {
        Self { stream: Some(stream), home: Handle::current().id() }
    }

    /// The stream, registered with the caller's runtime.
    fn stream(&mut self) -> io::Result<Pin<&mut TcpStream>> {
        let here = Handle::current().id();
        if self.home != here {
            let moved = self.stream.take().map(|stream| TcpStream::from_std(stream.into_std()?));
            self.stream = moved.transpose()?;
            self.home = here;
        }
        self.stream.as_mut().map(Pin::new).ok_or_else(|| io::ErrorKind::NotConnected.into())
    }
}

/// Sets the option that the kernel resets by itself, so after each read. Without it answers are later.
#[cfg_attr(not(target_os = "linux"), expect(unused_variables, reason = "Linux alone has this option"))]
fn acknowledge(stream: &TcpStream) {
    #[cfg(target_os = "linux")]
    let _ = socket2::SockRef::from(stream).set_tcp_quickack(true);
}

impl QuickAckStream {
    /// The stream itself; an error where a move has failed.
    pub fn into_inner(self) -> io::Result<TcpStream> {
        self.stream.ok_or_else(|| io::ErrorKind::NotConnected.into())
    }
}

impl AsyncRead for QuickAckStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let mut stream = self.stream()?;
        ready!(stream.as_mut().poll_read(cx, buffer))?;
        acknowledge(&stream);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for QuickAckStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.stream()?.poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
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
