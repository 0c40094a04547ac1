//! The check of a TCP client's first bytes.

use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, ReadBuf};

use super::port::Port;
use crate::wsg::Opening;

/// Reads a client's bytes, and fails at those of a client that speaks another protocol, before any of them is a request.
pub(super) struct CheckedReader<R> {
    reader: R,
    opening: Opening,
    port: Arc<Port>,
    peer: SocketAddr,
}

impl<R> CheckedReader<R> {
    pub(super) fn new(reader: R, port: Arc<Port>, peer: SocketAddr) -> Self {
        Self { reader, opening: Opening::default(), port, peer }
    }
}

impl<R: AsyncRead + Unpin> AsyncRead for CheckedReader<R> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = &mut *self;
        if this.opening == Opening::Foreign {
            return Poll::Ready(Err(ErrorKind::InvalidData.into()));
        }
        let before = out.filled().len();
        ready!(Pin::new(&mut this.reader).poll_read(cx, out))?;
        let received = out.filled().get(before..).unwrap_or_default();
        if this.opening.accepts(received) {
            return Poll::Ready(Ok(()));
        }
        this.port.metrics.foreign.closed(this.peer, received);
        out.set_filled(before);
        Poll::Ready(Err(ErrorKind::InvalidData.into()))
    }
}
