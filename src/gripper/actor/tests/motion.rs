//! Ends of motions.

use super::*;
use crate::handle::Ticket;
use crate::recorder::Record;
use model::{Action, Code, CommandId, Motion, Outcome, Submission};
use wsg::{Force, Speed, Width};

/// Begins a motion whose replies the device holds back.
fn release(rig: &mut Rig) -> (CommandId, Ticket) {
    rig.device.held.insert(id::RELEASE);
    begin(rig, Motion::Release { width: Width::new(50.0).unwrap(), speed: Speed::new(50.0).unwrap() })
}

fn begin(rig: &mut Rig, motion: Motion) -> (CommandId, Ticket) {
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

/// Begins a motion and cancels it so many times. The device has not replied to the Stop.
fn cancelled(times: usize) -> Rig {
    let mut rig = Rig::connected(config(TCP));
    rig.device.held.insert(id::STOP);
    let (id, _) = release(&mut rig);
    rig.reply(id::RELEASE, Status::E_CMD_PENDING, &[]);
    for _ in 0..times {
        let (answer, _) = oneshot::channel();
        rig.actor.request(rig.now, ActorRequest::Cancel { id, client: client(), answer });
        rig.exchange();
    }
    assert_eq!(rig.count(id::STOP), 1);
    rig
}

#[test]
fn waiting_stop_goes_before_the_next_motion() {
    let mut rig = cancelled(2);
    rig.reply(id::RELEASE, Status::E_CMD_ABORTED, &[]);
    rig.pass(60);
    release(&mut rig);
    assert_eq!(rig.count(id::RELEASE), 1, "the motion waits for the second Stop");
    rig.device.held.clear();
    rig.reply(id::STOP, Status::E_SUCCESS, &[]);
    rig.exchange();
    let ids: Vec<_> = rig.device.received.iter().map(|(id, _)| *id).collect();
    assert!(rig.count(id::STOP) == 2 && ids.ends_with(&[id::STOP, id::RELEASE]), "{ids:?}");
}

#[test]
fn own_stop_without_success_is_repeated() {
    let mut rig = cancelled(1);
    for sent in 1..=3 {
        assert_eq!(rig.count(id::STOP), sent);
        rig.reply(id::STOP, Status::E_CHECKSUM_ERROR, &[]);
        rig.exchange();
    }
    assert_eq!(rig.count(id::STOP), 3);
}

#[test]
fn own_stop_is_not_repeated_for_the_next_motion() {
    let mut rig = cancelled(1);
    rig.reply(id::RELEASE, Status::E_CMD_ABORTED, &[]);
    rig.pass(60);
    release(&mut rig);
    rig.reply(id::STOP, Status::E_CHECKSUM_ERROR, &[]);
    rig.exchange();
    assert_eq!((rig.count(id::STOP), rig.count(id::RELEASE)), (1, 2));
}

#[test]
fn grip_waits_while_its_device_is_set_up_again() {
    let mut rig = Rig::connected(config(LinkProperties { name: "serial", may_duplicate: false, ..UDP }));
    rig.device.held.extend([id::SET_FORCE_LIMIT, id::GET_SYSTEM_INFO, id::GRIP]);
    let width = Width::new(20.0).unwrap();
    let speed = Speed::new(50.0).unwrap();
    let force = Some(Force::new(30.0).unwrap());
    begin(&mut rig, Motion::Grip { width, speed, force, part_id: None, recipe: None, is_reference: false });
    assert_eq!(rig.count(id::SET_FORCE_LIMIT), 1);
    rig.actor.set_up_again(rig.now);
    rig.reply(id::SET_FORCE_LIMIT, Status::E_SUCCESS, &[]);
    rig.exchange();
    assert_eq!((rig.count(id::GET_SYSTEM_INFO), rig.count(id::GRIP)), (1, 0), "the settings are checked first");
    rig.device.held = BTreeSet::from([id::GRIP]);
    rig.reply(id::GET_SYSTEM_INFO, Status::E_SUCCESS, &[1, 1, 0x20, 0x40, 7, 0, 0, 0]);
    rig.pass(10);
    assert_eq!(rig.count(id::GRIP), 1);
}

#[test]
fn motion_that_cannot_begin_in_time_is_refused() {
    let mut rig = Rig::connected(config(TCP));
    release(&mut rig);
    rig.reply(id::RELEASE, Status::E_CMD_PENDING, &[]);
    rig.reply(id::RELEASE, Status::E_SUCCESS, &[]);
    let (_, waiting) = release(&mut rig);
    // As if the process had been frozen during the pause.
    rig.pass(2500);
    let command = waiting.now();
    assert_eq!((command.outcome, command.code), (Some(Outcome::Refused), Some(Code::DeviceTimeout)));
    assert!(command.detail.unwrap().contains("could not begin within 2500 ms"));
    assert_eq!(rig.count(id::RELEASE), 1);
}

#[test]
fn motion_without_any_sign_counts_as_moving_until_the_next_flags() {
    let mut rig = Rig::connected(config(TCP));
    rig.device.held.extend([id::LOOP, id::GET_SYSTEM_STATE]);
    let (id, ticket) = release(&mut rig);
    for _ in 0..15 {
        rig.pass(100);
    }
    assert_eq!(ticket.now().outcome, Some(Outcome::Unknown));
    assert!(rig.actor.is_moving(rig.now.instant), "the device is silent");
    let flags = rig.device.flags;
    for (flags, mover) in [(flags | SystemState::MOVING, Some(id)), (flags, None)] {
        rig.reply(id::GET_SYSTEM_STATE, Status::E_SUCCESS, &flags.bits().to_le_bytes());
        assert_eq!(rig.actor.is_moving(rig.now.instant), mover.is_some());
        assert_eq!(rig.actor.motion.mover(rig.now.instant), mover);
    }
}

#[test]
fn stop_without_a_valid_result_is_unknown() {
    for (reply, code) in [(&[0_u8][..], Code::DeviceProtocol), (&[26, 0], Code::DeviceTimeout)] {
        let mut rig = Rig::connected(config(TCP));
        rig.device.held.insert(id::STOP);
        let id = rig.ids.command_id(rig.now.wall);
        let submission = Submission { client: client(), action: Action::Stop, request_id: None, lease: None };
        let mut answered = rig.request(|answer| ActorRequest::Submit { submission, id, answer });
        let ticket = answered.try_recv().unwrap().unwrap();
        let mut bytes = Vec::new();
        frame::encode(id::STOP, reply, &mut bytes);
        rig.actor.receive(rig.now, &bytes);
        for _ in 0..11 {
            rig.pass(100);
        }
        let command = ticket.now();
        assert_eq!((command.outcome, command.code), (Some(Outcome::Unknown), Some(code)), "{:?}", command.detail);
        let waits_long = command.detail.clone().unwrap_or_default().contains("30000");
        assert!(!waits_long, "{:?}", command.detail);
    }
}

const GETTERS: [u8; 5] = [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE];

/// A device with automatic updates that has just accepted a motion. It holds back the replies to all getters.
fn moving(properties: LinkProperties, motion: Motion) -> (Rig, Ticket) {
    let mut rig = Rig::connected(config(properties));
    rig.device.held.extend(GETTERS);
    let request = motion.request().id();
    rig.device.held.insert(request);
    rig.updates(GETTERS);
    let (_, ticket) = begin(&mut rig, motion);
    rig.reply(request, Status::E_CMD_PENDING, &[]);
    rig.device.received.clear();
    (rig, ticket)
}

impl Rig {
    /// Sends the present values of these getters, as automatic updates or as replies.
    pub(super) fn updates<const N: usize>(&mut self, ids: [u8; N]) {
        for id in ids {
            let (status, data) = self.device.execute(id, &[]);
            self.reply(id, status, &data);
        }
    }

    /// Ends the motion, after all values have just come as updates. Returns the getters that the device gets then.
    fn end_motion(&mut self, request: u8, status: Status) -> Vec<u8> {
        self.updates(GETTERS);
        self.reply(request, status, &[]);
        self.exchange();
        self.device.received.iter().map(|(id, _)| *id).collect()
    }
}

fn release_motion() -> Motion {
    Motion::Release { width: Width::new(50.0).unwrap(), speed: Speed::new(50.0).unwrap() }
}

#[test]
fn result_has_values_requested_at_the_end_of_the_motion() {
    let (mut rig, ticket) = moving(TCP, release_motion());
    assert_eq!(rig.end_motion(id::RELEASE, Status::E_SUCCESS), GETTERS);
    assert_eq!(ticket.now().outcome, None, "the values known so far were measured before the end");
    rig.now.instant += Duration::from_micros(200);
    rig.updates([id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED]);
    assert_eq!(ticket.now().outcome, None, "the force is from before the end");
    rig.updates([id::GET_FORCE]);
    let command = ticket.now();
    assert_eq!((command.outcome, command.width_mm, command.force_n), (Some(Outcome::Success), Some(0.0), Some(0.0)));
    assert!(rig.actor.observed.flows(), "the replies are no sign that the updates have stopped");
}

#[test]
fn slow_line_gets_no_requests_for_the_values_of_a_result() {
    let serial = LinkProperties { name: "serial", bytes_per_second: Some(11_520), ..TCP };
    let (mut rig, ticket) = moving(serial, release_motion());
    assert!(rig.end_motion(id::RELEASE, Status::E_SUCCESS).is_empty());
    rig.now.instant += Duration::from_millis(12);
    rig.updates(GETTERS);
    assert_eq!(ticket.now().outcome, Some(Outcome::Success));
}

/// Such requests would switch the updates on again that a drain switches off.
#[test]
fn drain_requests_no_values_at_the_end_of_a_motion() {
    let (mut rig, ticket) = moving(TCP, release_motion());
    let (answer, _drained) = oneshot::channel();
    rig.actor.request(rig.now, ActorRequest::Drain { answer });
    assert!(rig.end_motion(id::RELEASE, Status::E_SUCCESS).is_empty());
    rig.now.instant += Duration::from_millis(10);
    rig.updates(GETTERS);
    assert_eq!(ticket.now().outcome, Some(Outcome::Success));
}

#[test]
fn grip_whose_requested_state_is_grasping_waits_for_holding() {
    const GRASPING: u8 = 1;
    const HOLDING: u8 = 4;
    let width = Width::new(20.0).unwrap();
    let speed = Speed::new(50.0).unwrap();
    let grip = Motion::Grip { width, speed, force: None, part_id: None, recipe: None, is_reference: false };
    let (mut rig, ticket) = moving(TCP, grip);
    rig.device.gripper_state = GRASPING;
    assert_eq!(rig.end_motion(id::GRIP, Status::E_SUCCESS), GETTERS);
    rig.now.instant += Duration::from_micros(200);
    rig.updates(GETTERS);
    assert_eq!(ticket.now().outcome, None);
    rig.device.gripper_state = HOLDING;
    rig.now.instant += Duration::from_millis(10);
    rig.updates(GETTERS);
    assert_eq!(ticket.now().outcome, Some(Outcome::PartHeld));
}
