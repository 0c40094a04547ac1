//! Attacks that take minutes.

mod busy;
mod connects;
mod crowded_ports;
mod few_descriptors;
mod heads;
mod memory;
mod pipelines;
mod request_ids;
mod slow;
mod soak;
mod streams;
mod unfinished_stops;
mod unread;

use std::sync::Arc;

use crate::attacker::Crowd;

pub use soak::soak_time;

/// Starts the attack of this name, if it is defined here.
pub fn attack(name: &str, crowd: &Arc<Crowd>, count: usize) {
    match name {
        "busy_observers" => busy::begin(crowd, count),
        "come_and_go" => crowd.each(count, soak::come_and_go),
        "connect_and_close" => connects::close(crowd, count),
        "connect_and_hold" => connects::hold(crowd, count),
        "half_heads" => crowd.each(count, heads::half_head),
        "greedy_sockets" => crowd.each(count, memory::greedy_socket),
        "pipelines" => crowd.each(count, pipelines::pipeline),
        "stops_with_ids" => request_ids::begin(crowd, count),
        "tricklers" => crowd.each(count, slow::trickler),
        "all_by_stream" => crowd.each(count, streams::by_stream),
        "all_by_socket" => crowd.each(count, streams::by_socket),
        "unread_answers" => crowd.each(count, unread::unread),
        _ => {}
    }
}
