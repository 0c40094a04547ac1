//! Attacks in every run of the tests.

mod bodies;
mod descriptors;
mod polls;
mod sockets;
mod spellings;
use std::sync::Arc;

use crate::attacker::Crowd;

pub use sockets::{healthy_socket, subscribed};

/// Starts the attack of this name, if it is defined here.
pub fn attack(name: &str, crowd: &Arc<Crowd>, count: usize) {
    match name {
        "half_sent_bodies" => crowd.each(count, bodies::half_sent_body),
        "long_polls" => polls::begin(crowd, count),
        "healthy_sockets" => crowd.each(count, healthy_socket),
        _ => {}
    }
}
