//! Ends of motions.

use super::*;
use crate::gripper::handle::Ticket;
use crate::gripper::model::{Action, Code, CommandId, Motion, Outcome, Submission};
use crate::gripper::recorder::Record;
use crate::wsg::{Speed, Width};

/// Begins a motion whose replies the device holds back.
fn release(rig: &mut Rig) -> (CommandId, Ticket) {
    rig.device.held.insert(id::RELEASE);
    let motion = Motion::Release { width: Width::new(50.0).unwrap(), speed: Speed::new(50.0).unwrap() };
    let (id, action) = (rig.ids.command_id(rig.now.wall), Action::Motion(motion));
    let submission = Submission { client: client(), action, request_id: None, lease: None };
    let mut answered = rig.request(|answer| ActorRequest::Submit { submission, id, answer });
    (id, answered.try_recv().unwrap().unwrap())
}

#[test]
fn failed_motion_says_why() {
    for (status, outcome, code, remedy) in [
        (Status::E_AXIS_BLOCKED, Outcome::Blocked, Code::DeviceRefused, "remove the obstacle"),
        (Status::E_RANGE_ERROR, Outcome::Range, Code::OutOfRange, "within the limits"),
        (Status::E_TIMEOUT, Outcome::Timeout, Code::DeviceRefused, "nothing hinders the fingers"),
        (Status::E_CMD_FAILED, Outcome::Failed, Code::DeviceRefused, "check the state"),
    ] {
        let mut rig = Rig::connected(config(TCP));
        let (id, ticket) = release(&mut rig);
        rig.reply(id::RELEASE, Status::E_CMD_PENDING, &[]);
        rig.reply(id::RELEASE, status, &[]);
        rig.now.instant += Duration::from_millis(60);
        rig.actor.handle_timeout(rig.now);

        let command = ticket.now();
        let detail = command.detail.clone().unwrap_or_default();
        assert_eq!((command.outcome, command.code), (Some(outcome), Some(code)), "{detail}");
        assert!(detail.contains(&status.to_string()) && detail.contains(remedy), "{detail}");
        rig.actor.drained(rig.now);
        let records: Vec<_> = std::iter::from_fn(|| rig.actor.poll_record()).map(|(record, _)| record).collect();
        let event = records.iter().find_map(|record| match record {
            Record::Event(event, _) if event.command_id == Some(id) => Some(serde_json::to_value(event).unwrap()),
            _ => None,
        });
        let event = event.expect("an event");
        assert_eq!((&event["code"], &event["cause"]), (&code.word().into(), &detail.clone().into()));
        let grip = records.iter().find_map(|record| match record {
            Record::Grip(grip) => Some((grip.code, grip.detail.clone())),
            _ => None,
        });
        assert_eq!(grip, Some((Some(code), Some(detail))));
    }
}

/// Cancels a motion twice, of which the second Stop waits for the reply to the first. Returns the number of Stops sent
/// after the device has ended the motion.
fn stops_of_two_cancels(meanwhile: impl FnOnce(&mut Rig)) -> usize {
    let mut rig = Rig::connected(config(TCP));
    rig.device.held.insert(id::STOP);
    let (cancelled, _) = release(&mut rig);
    rig.reply(id::RELEASE, Status::E_CMD_PENDING, &[]);
    for _ in 0..2 {
        let (answer, _) = oneshot::channel();
        rig.actor.request(rig.now, ActorRequest::Cancel { id: cancelled, client: client(), answer });
        rig.exchange();
    }
    assert_eq!(rig.count(id::STOP), 1);
    meanwhile(&mut rig);
    rig.reply(id::RELEASE, Status::E_CMD_ABORTED, &[]);
    rig.pass(60);
    release(&mut rig);
    rig.reply(id::STOP, Status::E_SUCCESS, &[]);
    rig.exchange();
    assert_eq!(rig.count(id::RELEASE), 2);
    rig.count(id::STOP)
}

#[test]
fn second_cancel_does_not_stop_the_next_motion() {
    assert_eq!(stops_of_two_cancels(|_| ()), 1);
}

#[test]
fn stop_with_another_reason_is_sent_after_a_cancelled_motion() {
    assert_eq!(stops_of_two_cancels(|rig| rig.actor.link.send_stop(rig.now)), 2);
}
