//! The client behind a request.

use std::net::SocketAddr;

use axum::extract::ConnectInfo;
use axum::http::Extensions;

use crate::gripper::model::{Client, Door};

/// Returns the client of a request. Without authentication, the peer's address identifies the client.
pub fn client(extensions: &Extensions) -> Client {
    client_of(Door::Http, "http", extensions)
}

pub fn websocket_client(extensions: &Extensions) -> Client {
    client_of(Door::Ws, "ws", extensions)
}

fn client_of(door: Door, name: &str, extensions: &Extensions) -> Client {
    let subject = match extensions.get::<ConnectInfo<SocketAddr>>() {
        Some(ConnectInfo(peer)) => format!("{name}:{}", peer.ip().to_canonical()),
        None => format!("{name}:unknown"),
    };
    Client { subject: subject.into(), door }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn client_is_known_by_its_address() {
        let mut extensions = Extensions::new();
        extensions.insert(ConnectInfo("[::ffff:10.0.0.7]:5000".parse::<SocketAddr>().unwrap()));
        assert_eq!(&*client(&extensions).subject, "http:10.0.0.7");
    }
}
