//! Inspection of a connection's first bytes, which decide the runtime that serves it. With TLS, they arrive after the
//! handshake.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use bytes::BytesMut;
use socket2::SockRef;
use tokio::io::AsyncReadExt as _;
use tokio::net::TcpStream;
use tokio::runtime::Handle;
use tokio::time::{sleep, timeout};
use tokio_rustls::LazyConfigAcceptor;
use tokio_rustls::rustls::server::Acceptor;
use tokio_util::task::AbortOnDropHandle;

use super::super::http_settings::HttpSettings;
use super::super::requests::fast_stop::{begins_with_fast_stop, may_be_fast_stop};
use super::redirect;
use crate::access::ClientCertificate;
use crate::connections::accept::{FIRST_BYTES, FIRST_BYTES_WITHIN, REST_WITHIN, peek_now};
use crate::connections::admission::ConnectionPermit;
use crate::connections::client_stream::{ClientStream, EncryptedStream};
use crate::connections::handshakes::Handshakes;
use crate::connections::quick_ack::QuickAckStream;
use crate::connections::sockets;
use crate::connections::tls::holder;

/// Unsent bytes that the kernel queues for a slow client: some dozens of updates.
#[cfg(target_os = "linux")]
const MAX_UNSENT_BYTES: u32 = 16 * 1024;

/// Time after which a handshake's turn ends although it continues: a client that has gone silent needs no processor.
const HANDSHAKE_TURN: Duration = Duration::from_millis(5);

/// First byte of a connection that speaks TLS (RFC 8446, 5.1).
const TLS_HANDSHAKE: u8 = 22;

/// A connection whose first line has been inspected.
pub(super) struct Begun {
    pub(super) stream: ClientStream,
    pub(super) certificate: Option<ClientCertificate>,
    /// Whether the connection begins with a FAST STOP.
    pub(super) is_fast_stop: bool,
    /// Whether this FAST STOP has arrived as a whole.
    pub(super) is_whole: bool,
}

/// Result of an inspection.
pub(super) enum Inspected {
    Begun(Begun),
    /// The connection was evicted before its first byte.
    Evicted(TcpStream),
    /// The connection has ended, or was silent for too long.
    Ended,
}

/// Inspects the first bytes of a connection, which stay to be read.
pub(super) async fn inspect(
    stream: TcpStream,
    peer: SocketAddr,
    permit: &ConnectionPermit,
    idle_time: Duration,
) -> Inspected {
    let mut first = [0; FIRST_BYTES];
    let mut seen = tokio::select! {
        biased;
        seen = stream.peek(&mut first) => seen.unwrap_or(0),
        // Bytes that arrived before the eviction still count.
        () = permit.evicted() => match peek_now(&stream, &mut first) {
            0 => return Inspected::Evicted(stream),
            seen => seen,
        },
        () = sleep(idle_time) => 0,
    };
    if seen == 0 {
        return Inspected::Ended;
    }
    if !first.contains(&b'\n') && seen < FIRST_BYTES {
        // The first line can arrive in two packets.
        sleep(FIRST_BYTES_WITHIN).await;
        seen = peek_now(&stream, &mut first);
    }
    if may_be_fast_stop(&first) && !begins_with_fast_stop(first.get(..seen).unwrap_or_default()) {
        // Many clients send head and body one right after the other.
        sleep(REST_WITHIN).await;
        seen = peek_now(&stream, &mut first);
    }
    // A connection that sends nothing never gets here and costs no call.
    if prepare(&stream, peer).is_none() {
        return Inspected::Ended;
    }
    let first = first.get(..seen).unwrap_or_default();
    let is_fast_stop = may_be_fast_stop(first);
    let is_whole = begins_with_fast_stop(first);
    let stream = ClientStream::Left(QuickAckStream::new(stream));
    Inspected::Begun(Begun { stream, certificate: None, is_fast_stop, is_whole })
}

/// Performs a TLS handshake, and reads the first line behind it. A client that does not speak TLS is redirected.
pub(super) async fn decrypt(
    handshakes: &Handshakes,
    requests: &Handle,
    settings: Arc<HttpSettings>,
    stream: TcpStream,
    peer: SocketAddr,
) -> Option<Begun> {
    prepare(&stream, peer)?;
    let mut kind = [0];
    if stream.peek(&mut kind).await.ok()? == 0 {
        return None;
    }
    if kind != [TLS_HANDSHAKE] {
        let answered = redirect::answer(stream, settings);
        let _ = AbortOnDropHandle::new(requests.spawn(answered)).await;
        return None;
    }
    // The first message of a client costs little, so a client that sends none takes no turn.
    let hello = LazyConfigAcceptor::new(Acceptor::default(), QuickAckStream::new(stream)).await;
    let hello = hello.inspect_err(|error| tracing::debug!(%peer, %error, "no TLS connection")).ok()?;
    let turn = handshakes.turn(peer.ip()).await;
    let tls = settings.tls.as_ref()?.config();
    let handshake = async move {
        let mut stream = hello.into_stream(tls).await?;
        let mut first = BytesMut::with_capacity(FIRST_BYTES);
        while !first.contains(&b'\n') && first.len() < FIRST_BYTES {
            if stream.read_buf(&mut first).await? == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
        }
        if may_be_fast_stop(&first) && !begins_with_fast_stop(&first) {
            // An error shows in the next read.
            let _ = timeout(REST_WITHIN, stream.read_buf(&mut first)).await;
        }
        io::Result::Ok((first.freeze(), stream))
    };
    // A handshake takes as much processor time as many requests, and a FAST STOP must not wait for it.
    let mut handshake = AbortOnDropHandle::new(requests.spawn(handshake));
    let in_turn = timeout(HANDSHAKE_TURN, &mut handshake).await;
    drop(turn);
    let handshake = match in_turn {
        Ok(handshake) => handshake,
        Err(_) => handshake.await,
    };
    let (first, stream) =
        handshake.ok()?.inspect_err(|error| tracing::debug!(%peer, %error, "no TLS connection")).ok()?;
    let certificate = stream.get_ref().1.peer_certificates().and_then(|chain| holder(chain.first()?));
    let is_fast_stop = may_be_fast_stop(&first);
    let is_whole = begins_with_fast_stop(&first);
    let stream = ClientStream::Right(Box::new(EncryptedStream::new(first, stream)));
    Some(Begun { stream, certificate, is_fast_stop, is_whole })
}

/// Sets a connection's options. Responses are small and awaited. An open request keeps a lease, so a vanished client
/// must be noticed.
fn prepare(stream: &TcpStream, peer: SocketAddr) -> Option<()> {
    if let Err(error) = sockets::prepare(stream) {
        tracing::debug!(%peer, %error, "connection refused: socket options could not be set");
        return None;
    }
    set_unsent_limit(stream);
    Some(())
}

/// Limits the unsent bytes in the kernel, which would be stale before the client reads them and defeat newest-wins.
fn set_unsent_limit(stream: &TcpStream) {
    #[cfg(target_os = "linux")]
    if let Err(error) = SockRef::from(stream).set_tcp_notsent_lowat(MAX_UNSENT_BYTES) {
        tracing::debug!(%error, "TCP_NOTSENT_LOWAT could not be set");
    }
}
