//! The listener.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use socket2::SockRef;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::adu;
use super::connection::ModbusConnection;
use super::context::{ModbusContext, ModbusSettings, NewestSettings};
use crate::connections::accept::{self, FastStopRule};
use crate::connections::admission::{Admission, Bounds};
use crate::connections::sockets;
use crate::model::Door;

/// Accepts clients until `draining`, and serves them until `closing`. They use this many descriptors at most.
///
/// # Errors
/// The operating system's error if the listener cannot be registered.
pub async fn serve(
    context: Arc<ModbusContext>,
    (listener, descriptors): (std::net::TcpListener, usize),
    settings: watch::Receiver<Arc<ModbusSettings>>,
    (draining, closing): (CancellationToken, CancellationToken),
) -> io::Result<()> {
    let listener = TcpListener::from_std(listener)?;
    let settings = NewestSettings::of(settings);
    let admission = Admission::new(Bounds::alike(descriptors));
    let admitting = admission.clone();
    let clients = accept::each(&listener, &admission, &draining, FAST_STOP, move |stream, peer| {
        admit(&context, &settings, &admitting, stream, peer).map(|connection| connection.run(closing.clone()))
    });
    let mut clients = clients.await;
    drop(listener);
    while clients.join_next().await.is_some() {}
    Ok(())
}

const FAST_STOP: FastStopRule = FastStopRule { may_begin: adu::begins_with_write, is_whole: adu::begins_with_write };

fn admit(
    context: &Arc<ModbusContext>,
    settings: &NewestSettings,
    admission: &Arc<Admission>,
    stream: TcpStream,
    peer: SocketAddr,
) -> Option<ModbusConnection> {
    let peers = &settings.now().peers;
    if !peers.allows(peer.ip()) {
        tracing::warn!(%peer, "Modbus connection refused: add the address to modbus_allow or to a [[clients]] section");
        return None;
    }
    if let Err(error) = prepare(&stream) {
        // The connection has just ended.
        tracing::debug!(%peer, %error, "Modbus connection refused: socket options could not be set");
        return None;
    }
    let client = peers.client(peer.ip(), "modbus", Door::Modbus);
    tracing::info!(%peer, client = %client.subject, "Modbus client connected");
    // Clients have their own shutdown signal.
    let permit = Arc::new(admission.admit(peer.ip(), &CancellationToken::new()));
    Some(ModbusConnection::new(context.clone(), settings.clone(), (client, peer.ip()), permit, stream))
}

/// Sends answers at once, and detects a vanished peer even while an answer is in flight to it.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    sockets::prepare(stream)?;
    SockRef::from(stream).set_tcp_user_timeout(Some(sockets::LOST_AFTER))
}
