//! Attacks in every run of the tests.

mod bodies;
pub mod crowded_ports;
mod descriptors;
mod mqtt_requests;
mod polls;
mod sockets;
mod spellings;
pub mod unfinished_stops;

use std::sync::Arc;

use crate::attacker::Crowd;

pub use crowded_ports::{attacked, modbus, other_port};
pub use sockets::{healthy_socket, subscribed};

/// Starts the attack of this name, if it is defined here.
pub fn attack(name: &str, crowd: &Arc<Crowd>, count: usize) {
    match name {
        "cyclic_reads" => crowd.each_at_once(count, crowded_ports::cyclic_reads),
        "half_sent_stops" => crowd.each_at_once(count, unfinished_stops::half_sent_stop),
        "idle" => crowd.each_at_once(count, crowded_ports::idle),
        "modbus_stops" => crowd.each_at_once(count, crowded_ports::modbus_stops),
        "port_stops" => crowd.each_at_once(count, crowded_ports::port_stops),
        "half_sent_bodies" => crowd.each(count, bodies::half_sent_body),
        "long_polls" => polls::begin(crowd, count),
        "healthy_sockets" => crowd.each(count, healthy_socket),
        _ => {}
    }
}
