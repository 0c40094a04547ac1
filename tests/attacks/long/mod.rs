//! The attacks that take minutes.

mod busy;
mod connects;
mod few_descriptors;
mod heads;
mod memory;
mod pipelines;
mod request_ids;
mod slow;
mod streams;
mod unread;

use std::sync::Arc;

use crate::attacker::Crowd;

/// Begins an attack of this name, if it is one of these.
pub async fn attack(name: &str, crowd: &Arc<Crowd>, count: usize) {
    match name {
        "busy_observers" => busy::begin(crowd, count).await,
        "connect_and_close" => connects::close(crowd, count).await,
        "connect_and_hold" => connects::hold(crowd, count).await,
        "half_heads" => crowd.each(count, heads::half_head).await,
        "greedy_sockets" => crowd.each(count, memory::greedy_socket).await,
        "pipelines" => crowd.each(count, pipelines::pipeline).await,
        "stops_with_ids" => request_ids::begin(crowd, count).await,
        "tricklers" => crowd.each(count, slow::trickler).await,
        "all_by_stream" => crowd.each(count, streams::by_stream).await,
        "all_by_socket" => crowd.each(count, streams::by_socket).await,
        "unread_answers" => crowd.each(count, unread::unread).await,
        _ => {}
    }
}
