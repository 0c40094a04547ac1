//! A connection whose data are acknowledged at once, and that is watched by the runtime that serves it.
//!
//! Many clients send a request's header and its body in two packets, and hold the second back until the first one is
//! acknowledged, which the kernel puts off by 40 ms. Those would be lost for every such request on a kept connection,
//! a FAST STOP's reason among them.
//!
//! A connection that becomes a WebSocket leaves the runtime that has accepted it, whose threads would be woken by
//! whatever a thousand observers send and take, and which has FAST STOPs to serve.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::runtime::{self, Handle};

/// It.
#[derive(Debug)]
pub struct Prompt {
    /// None after it could not be moved, which ends it.
    stream: Option<TcpStream>,
    /// The runtime that watches it.
    home: runtime::Id,
}

impl Prompt {
    /// Of a connection that was accepted by this runtime.
    pub fn new(stream: TcpStream) -> Self {
        Self { stream: Some(stream), home: Handle::current().id() }
    }

    /// The connection, watched by the runtime that asks for it.
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

/// The kernel forgets it again, so it is said after each read. Where it can't be said, the answers are just later.
#[cfg_attr(not(target_os = "linux"), expect(unused_variables, reason = "no other system can be told"))]
fn acknowledge(stream: &TcpStream) {
    #[cfg(target_os = "linux")]
    let _ = socket2::SockRef::from(stream).set_tcp_quickack(true);
}

impl AsyncRead for Prompt {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let mut stream = self.stream()?;
        ready!(stream.as_mut().poll_read(cx, buffer))?;
        acknowledge(&stream);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Prompt {
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
