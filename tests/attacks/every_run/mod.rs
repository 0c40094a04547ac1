//! The attacks that each run of the tests makes.

mod bodies;
mod descriptors;
mod polls;
mod sockets;
mod spellings;
use std::sync::Arc;

use crate::attacker::Crowd;

pub use sockets::{healthy_socket, subscribed};

/// Begins an attack of this name, if it is one of these.
pub fn attack(name: &str, crowd: &Arc<Crowd>, count: usize) {
    match name {
        "half_sent_bodies" => crowd.each(count, bodies::half_sent_body),
        "long_polls" => polls::begin(crowd, count),
        "healthy_sockets" => crowd.each(count, healthy_socket),
        _ => {}
    }
}
