//! Fuzz target of the WSG port.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::device::{MAX_WAITING_FRAMES, VirtualDevice};
use super::order::PortReply;
use super::port::{AcknowledgePolicy, Rules};
use super::status::RefusedStatus;
use crate::gripper::FastStop;
use crate::model::{CustomIds, FastStopCause, FastStopId, LatchFields, Link, Name, Reason, State, Values};
use crate::wsg::{ChecksumEvaluation, Data, Decoded, Decoder, GripperState, Reply, Status, SystemState, frame, id};

/// Checks a client's session. Each frame for the client is valid, their number is bounded, and a FAST STOP at the end
/// is obeyed, whatever was sent before. Nothing in a payload is executed. The first byte sets the rules. Each later
/// byte selects a step.
pub(crate) fn session(data: &[u8]) {
    let Some((&rules, mut steps)) = data.split_first() else { return };
    let acknowledge = if rules & 2 == 2 { AcknowledgePolicy::Any } else { AcknowledgePolicy::Own };
    let rules = Rules { checksum_evaluation: rules % 2 == 1, acknowledge, ..Rules::default() };
    let Some((mut device, mut state)) = connected(&rules) else { return };
    nested(&rules, steps);
    let mut now = Instant::now();
    let mut orders = VecDeque::new();
    while let Some((&step, rest)) = steps.split_first() {
        steps = rest;
        match step {
            // The client sends up to 127 bytes.
            0..128 => {
                let (bytes, rest) = steps.split_at(steps.len().min(step.into()));
                steps = rest;
                device.receive(now, bytes, &state);
            }
            // Up to a second passes.
            128..160 => {
                let until = now + Duration::from_millis(32) * u32::from(step - 128);
                while let Some(at) = device.poll_timeout(now, &state).filter(|at| *at <= until) {
                    now = now.max(at);
                    device.handle_timeout(now, &state);
                }
                now = until;
            }
            160..224 => {
                let Some(asked) = orders.pop_front() else { continue };
                let refused = RefusedStatus { status: Status::E_ACCESS_DENIED, fast_stop: None };
                let reply = match step % 4 {
                    0 => PortReply::Accepted,
                    1 => PortReply::Reply(Reply::Success(Data::None)),
                    2 => PortReply::Refused(refused),
                    _ => PortReply::FastStopped(FastStop { id: FastStopId::generate(), confirmed: step < 192 }),
                };
                device.answer(now, asked, reply, &state);
            }
            224..240 => {
                state.values.changed_at = Some(now);
                state.latch = (step % 2 == 1).then(|| LatchFields {
                    fast_stop_id: FastStopId::generate(),
                    fast_stop_by: "device".into(),
                    fast_stop_cause: FastStopCause::Unknown,
                    fast_stop_reason: Reason::truncated(""),
                    fast_stop_at: jiff::Timestamp::UNIX_EPOCH,
                    fast_stop_confirmed: true,
                    epoch: 1,
                });
            }
            240.. => device.set_holder(step % 2 == 1),
        }
        orders.extend(std::iter::from_fn(|| device.poll_order()).map(|ordered| ordered.ask));
        while device.poll_refused().is_some() {}
        let frames: Vec<_> = std::iter::from_fn(|| device.poll_frame()).collect();
        assert!(frames.len() <= MAX_WAITING_FRAMES, "{} frames", frames.len());
        for frame in frames {
            check(&frame);
        }
    }
    // Incomplete frames time out. Bytes behind them can subscribe to updates, which would never end.
    device.forget_waiting();
    while let Some(at) = device.poll_timeout(now, &state) {
        device.handle_timeout(at, &state);
        device.forget_waiting();
        now = at;
    }
    let mut fast_stop = Vec::new();
    frame::encode(id::FAST_STOP, &[], &mut fast_stop);
    device.receive(now, &fast_stop, &state);
    assert!(device.is_stopping() || device.has_overflown(), "a FAST STOP was lost");
}

fn connected(rules: &Rules) -> Option<(VirtualDevice, State)> {
    let name = "g".parse::<Name>().ok()?;
    let custom_ids = CustomIds { read: [0xB2].into(), stream: [0xB1].into(), ..CustomIds::default() };
    let device = VirtualDevice::new("wsg:10.0.0.1".into(), rules, Arc::new(custom_ids), 10);
    let values = Values::fixed(SystemState::REFERENCED, GripperState::Idle, [20.0, 0.0, 0.0]);
    let state = State { link: Link::Connected, values, ..State::unknown(name) };
    Some((device, state))
}

/// Sends a frame with these bytes as payload, once and repeated, and checks that the payload causes nothing: no order,
/// no reply.
fn nested(rules: &Rules, bytes: &[u8]) {
    let Some((&id, bytes)) = bytes.split_first().filter(|(id, _)| **id != frame::PREAMBLE[0]) else { return };
    for times in [1, 1 + 5000 / bytes.len().max(1), 65_535 / bytes.len().max(1)] {
        let Some((mut device, state)) = connected(rules) else { return };
        let mut sent = Vec::new();
        let payload = bytes.repeat(times);
        // Looks like a Disconnect Announcement with a short size field.
        if id == id::DISCONNECT_ANNOUNCEMENT && payload.len() % 256 == 0 {
            continue;
        }
        frame::encode(id, &payload, &mut sent);
        for piece in sent.chunks(1000) {
            device.receive(Instant::now(), piece, &state);
        }
        let ordered: Vec<_> = std::iter::from_fn(|| device.poll_order()).map(|ordered| ordered.ask.id).collect();
        let replied: Vec<_> = std::iter::from_fn(|| device.poll_frame()).map(|frame| frame[3]).collect();
        assert!(
            matches!((&ordered[..], &replied[..]), ([one], []) | ([], [one]) if *one == id),
            "{ordered:?} {replied:?}"
        );
    }
}

/// Checks that these bytes are one frame.
fn check(frame: &[u8]) {
    let mut decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
    decoder.push(frame);
    assert!(matches!(decoder.next(), Some(Decoded::Frame(_))), "not a frame: {frame:02x?}");
    assert!(!decoder.is_partial(), "more than a frame: {frame:02x?}");
}
