//! Invariant checks on the frames that leave the gateway and on those that the device received.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use model::{Kind, Link, MeasuredFields, Outcome, Phase, State, UpdateMode};
use sim::Interface;
use wsg::{ChecksumEvaluation, Command, Decoded, Decoder, Reply, crc, frame, id};

use super::client::{Admitted, is_streamed};
use super::leases::Leases;
use super::servo::Servos;
use super::world::{PORT_SCRIPT_ID, SCRIPT_ID, STREAM_ID, World};

/// Observations so far.
#[derive(Default)]
pub struct Invariants {
    /// Number of times that each motion frame left, by its bytes.
    motions: BTreeMap<Vec<u8>, usize>,
    acknowledges_taken: usize,
    acknowledges_sent: usize,
    /// Whether a FAST STOP was requested and no frame has left since.
    fast_stop_is_next: bool,
    fast_stop_sent: Option<Instant>,
    outcomes: BTreeMap<usize, Outcome>,
    repeats: Repeats,
    values: HeardValues,
    /// Motion frames that the device received after their command had ended, and that no Stop has followed yet.
    late_motions: Vec<Instant>,
    /// Number of the device's received frames that were looked at.
    looked_at: u64,
}

/// Time within which a Stop has to follow a motion frame that arrives after its command has ended, also on a slow line.
const STOPS_WITHIN: Duration = Duration::from_millis(500);

/// Longest frame of a getter in these schedules.
const LONGEST_VALUE_BYTES: usize = 80;

/// Values that arrived at the gateway, found independently of it: at any offset, as soon as their bytes are complete.
#[derive(Default)]
struct HeardValues {
    /// Newest bytes that can belong to an incomplete frame.
    bytes: Vec<u8>,
    /// Arrival of the newest value by getter.
    newest: BTreeMap<u8, Instant>,
}

impl HeardValues {
    fn hear(&mut self, now: Instant, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        let mut start = 0;
        for offset in 0..self.bytes.len() {
            let Some((frame, id)) = whole_frame(&self.bytes[offset..]) else { continue };
            let payload = &frame[frame::HEADER_BYTES..frame.len() - 2];
            if let Ok(Reply::Success(_)) = Reply::parse(id, payload) {
                self.newest.insert(id, now);
            }
            start = offset + frame.len();
        }
        let start = start.max(self.bytes.len().saturating_sub(LONGEST_VALUE_BYTES));
        self.bytes.drain(..start);
    }
}

/// Returns the undamaged frame at the beginning of these bytes, and its id.
fn whole_frame(bytes: &[u8]) -> Option<(&[u8], u8)> {
    let header = bytes.strip_prefix(&frame::PREAMBLE)?;
    let size = usize::from(u16::from_le_bytes([*header.get(1)?, *header.get(2)?]));
    let frame = bytes.get(..size.checked_add(frame::OVERHEAD_BYTES)?)?;
    (crc::checksum(frame) == 0).then_some((frame, header[0]))
}

/// Pause after which a reply no longer ends the request after its own.
const SHIFTED_FOR: Duration = Duration::from_secs(1);

/// Replies of scripts that the device repeats. If a request is in flight, the gateway cannot tell the first such reply
/// from the reply to this request, because replies have no numbers. The reply to this request then ends the one after
/// it, and so on until the requests pause. Not on UDP, where the gateway expects each reply twice.
struct Repeats {
    decoder: Decoder,
    newest: BTreeMap<u8, Vec<u8>>,
    /// Time of the last reply that can have ended another request, by the ids of this connection that were repeated.
    shifted: BTreeMap<u8, Instant>,
    /// Echoes that may end another request.
    excused: BTreeSet<Vec<u8>>,
}

impl Default for Repeats {
    fn default() -> Self {
        let decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
        Self { decoder, newest: BTreeMap::new(), shifted: BTreeMap::new(), excused: BTreeSet::new() }
    }
}

impl Invariants {
    pub fn fast_stop_requested(&mut self) {
        self.fast_stop_is_next = true;
    }

    pub fn acknowledge_taken(&mut self) {
        self.acknowledges_taken += 1;
    }

    pub fn connected(&mut self) {
        let excused = std::mem::take(&mut self.repeats.excused);
        self.repeats = Repeats { excused, ..Repeats::default() };
        self.values.bytes.clear();
    }

    /// Notes bytes that leave the device.
    pub fn replied(&mut self, now: Instant, bytes: &[u8]) {
        let Repeats { decoder, newest, shifted, excused } = &mut self.repeats;
        decoder.push(bytes);
        while let Some(decoded) = decoder.next() {
            let Decoded::Frame(frame) = decoded else { continue };
            let (id, payload) = (frame.id, frame.payload.to_vec());
            let is_shifted = match shifted.get(&id) {
                Some(at) => now < *at + SHIFTED_FOR,
                // Status codes without data repeat often.
                None => id::is_custom(id) && payload.len() > 2 && newest.get(&id) == Some(&payload),
            };
            if is_shifted {
                shifted.insert(id, now);
                excused.extend(payload.get(2..).map(<[u8]>::to_vec));
            }
            newest.insert(id, payload);
        }
    }

    /// Notes bytes that arrive at the gateway.
    pub fn heard(&mut self, now: Instant, bytes: &[u8]) {
        self.values.hear(now, bytes);
    }

    /// Checks that no value is shown after its renewals have failed to arrive.
    fn check_values(world: &World) {
        let state = world.watches.state.borrow();
        let period = Duration::from_millis(world.watches.info.borrow().update_period_ms.into());
        let renewed_every = match world.config.rules.updates.mode {
            UpdateMode::Periodic => period,
            UpdateMode::Changes => Duration::from_millis(300).max(period),
        };
        let limit = Duration::from_millis(500).max(5 * renewed_every);
        let shown = MeasuredFields::at(&state.values, world.now);
        let all = [
            (id::GET_SYSTEM_STATE, shown.flags_raw.is_some()),
            (id::GET_GRIPPER_STATE, shown.state.is_some()),
            (id::GET_WIDTH, shown.width_mm.is_some()),
            (id::GET_SPEED, shown.speed_mm_s.is_some()),
            (id::GET_FORCE, shown.force_n.is_some()),
        ];
        for (id, _) in all.into_iter().filter(|(_, is_shown)| *is_shown) {
            let newest = world.invariants.values.newest.get(&id);
            // The gateway finds a frame behind a damaged one once that one's rest is overdue.
            let is_new = newest.is_some_and(|at| world.now < *at + limit + world.longest_frame());
            assert!(is_new, "old_is_not_live: {id:02X}h is shown, but came at {newest:?}\n{}", world.tail());
        }
        let says = state.fast_stop == Some(false) && state.link == Link::Connected;
        assert!(!says || shown.flags_raw.is_some(), "old_is_not_live: no FAST STOP is known\n{}", world.tail());
    }

    /// Checks that a motion frame that the device receives after its command has ended is stopped.
    fn check_late_motions(world: &mut World) {
        let received = world.device.snapshot().received_frames;
        let new = (received - world.invariants.looked_at) as usize;
        world.invariants.looked_at = received;
        let all = world.device.received();
        let mut is_late = false;
        for frame in &all[all.len() - new.min(all.len())..] {
            if matches!(frame.id, id::STOP | id::FAST_STOP | id::DISCONNECT_ANNOUNCEMENT) {
                world.invariants.late_motions.clear();
            }
            let bytes = encode_raw(frame.id, &frame.payload);
            let mut commands = world
                .clients
                .admitted
                .iter()
                .filter(|admitted| admitted.motion.as_ref().map(encode) == Some(bytes.clone()));
            let is_running = |admitted: &Admitted| admitted.ticket.now().phase == Phase::Running;
            let is_streamed = frame.id == STREAM_ID;
            if id::is_motion(frame.id) && !is_streamed && commands.clone().next().is_some() && !commands.any(is_running)
            {
                world.invariants.late_motions.push(frame.at);
                is_late = true;
            }
        }
        world.count("motion: received after its command had ended", is_late);
        let snapshot = world.device.snapshot();
        if !snapshot.moving || !world.is_connected() {
            world.invariants.late_motions.clear();
        }
        let is_over = |at: &Instant| world.now > *at + STOPS_WITHIN;
        assert!(!world.invariants.late_motions.iter().any(is_over), "nothing_moves_late\n{}", world.tail());
    }

    /// Whether this echo may end another request.
    pub fn is_excused(&self, echo: &[u8]) -> bool {
        self.repeats.excused.contains(echo)
    }

    /// Checks a frame that leaves the gateway.
    pub fn sent(world: &mut World, frame: &[u8]) {
        let frame_id = frame[3];
        world.note(&format!("> {}", hex::encode(frame)));
        let latched = world.watches.state.borrow().latch.is_some();
        let unconfirmed = world.watches.state.borrow().latch.as_ref().is_some_and(|latch| !latch.fast_stop_confirmed);
        if std::mem::take(&mut world.invariants.fast_stop_is_next) && unconfirmed {
            // An earlier FAST STOP whose reply is awaited for up to 100 ms also satisfies the rule, unless it has been
            // acknowledged since.
            let under_way =
                world.invariants.fast_stop_sent.is_some_and(|at| world.now < at + Duration::from_millis(100));
            assert!(frame_id == id::FAST_STOP || under_way, "fast_stop_overtakes\n{}", world.tail());
        }
        if frame_id == id::FAST_STOP {
            world.invariants.fast_stop_sent = Some(world.now);
        }
        if matches!(frame_id, id::STOP | id::FAST_STOP | id::DISCONNECT_ANNOUNCEMENT) {
            world.servos.superseded();
        }
        if Servos::sent(world, frame) {
            return assert!(!latched, "latch_blocks_motion\n{}", world.tail());
        }
        match frame_id {
            id::HOMING | id::PRE_POSITION | id::GRIP | id::RELEASE | SCRIPT_ID | STREAM_ID => {
                assert!(!latched, "latch_blocks_motion\n{}", world.tail());
                world.servos.superseded();
                let all = &world.clients.admitted;
                let admitted =
                    all.iter().filter(|admitted| admitted.motion.as_ref().map(encode).as_deref() == Some(frame));
                let running = admitted.clone().filter(|admitted| admitted.ticket.now().phase == Phase::Running);
                let mut may_leave = running.map(|admitted| Leases::may_leave(world, admitted.lease.as_ref()));
                assert!(may_leave.any(|may| may), "stale_lease_moves_nothing\n{}", world.tail());
                // A motion waits until its command is durable; only streams are exempt.
                let may_move = |admitted: &&Admitted| {
                    admitted.motion.as_ref().is_some_and(is_streamed)
                        || world.journal.is_durable(admitted.ticket.now().id)
                };
                let admitted = admitted.filter(may_move).count();
                let sent = world.invariants.motions.entry(frame.to_vec()).or_default();
                *sent += 1;
                let sent = *sent;
                assert!(admitted > 0, "nothing_moves_unasked\n{}", world.tail());
                assert!(sent <= admitted, "frame_sent_at_most_once\n{}", world.tail());
            }
            PORT_SCRIPT_ID => assert!(!latched, "latch_blocks_motion\n{}", world.tail()),
            id::ACKNOWLEDGE_FAST_STOP => {
                world.invariants.acknowledges_sent += 1;
                world.invariants.fast_stop_sent = None;
                let Self { acknowledges_sent, acknowledges_taken, .. } = world.invariants;
                assert!(acknowledges_sent <= acknowledges_taken, "acknowledge_names_its_latch\n{}", world.tail());
            }
            _ => {}
        }
    }

    /// Checks the commands after every step.
    pub fn check(world: &mut World) {
        Self::check_values(world);
        Self::check_late_motions(world);
        for (index, admitted) in world.clients.admitted.iter().enumerate() {
            let Some(outcome) = admitted.ticket.now().outcome else { continue };
            let first = *world.invariants.outcomes.entry(index).or_insert(outcome);
            assert_eq!(first, outcome, "every_command_ends_once\n{}", world.log.join("\n"));
            if let (Some(Command::Custom(custom)), Outcome::Success) = (&admitted.motion, outcome) {
                // The script echoes its payload.
                let payload = admitted.ticket.now().payload.and_then(|payload| hex::decode(&*payload).ok());
                let echo = payload.expect("a script's reply has a payload");
                let is_right = echo.is_empty() || echo == custom.payload() || world.invariants.is_excused(&echo);
                assert!(is_right, "reply of another command\n{}", world.log.join("\n"));
            }
        }
    }

    /// Whether all work is finished.
    pub fn is_at_rest(world: &World, since: Instant) -> bool {
        let state = world.watches.state.borrow();
        let unconfirmed = state.latch.as_ref().is_some_and(|latch| !latch.fast_stop_confirmed);
        // An acknowledgement that the device has carried out can end without a reply, and the next flags show it.
        let stopped = world.device.snapshot().fast_stop || !is_requested(&state);
        let ended = world.clients.tickets().all(|ticket| ticket.now().phase == Phase::Done);
        // An update since the faults ended shows that the link is not half-open.
        let heard = state.values.newest(world.now).is_some_and(|at| at > since + Duration::from_secs(1));
        let heard = heard && state.values.flags(world.now) == Some(world.device.snapshot().flags);
        state.link == Link::Connected
            && heard
            && !unconfirmed
            && stopped
            && ended
            // A target of a servo session has no ticket, and a series of widths can last for seconds.
            && state.command.is_none()
            && !state.servo.as_ref().is_some_and(|servo| servo.open)
            && world.clients.all_answered()
            && world.own_changes.all_answered()
    }

    /// Checks the final state, once all faults have ended.
    pub fn at_rest(world: &mut World) {
        let state = world.watches.state.borrow().clone();
        assert_eq!(state.link, Link::Connected, "the link is not restored: {:?}\n{}", state.link_cause, world.tail());
        assert!(world.clients.all_answered(), "a request has no answer\n{}", world.tail());
        assert!(world.own_changes.all_answered(), "a query has no answer\n{}", world.tail());
        assert_eq!(state.command, None, "{}", world.tail());
        let unconfirmed = state.latch.as_ref().is_some_and(|latch| !latch.fast_stop_confirmed);
        assert!(!unconfirmed, "unconfirmed FAST STOP\n{}", world.tail());
        let device_stopped = world.device.snapshot().fast_stop;
        assert!(!device_stopped || state.latch.is_some(), "device FAST STOP without a latch\n{}", world.tail());
        assert!(device_stopped || !is_requested(&state), "latch without a FAST STOP of the device\n{}", world.tail());
        world.count("FAST STOP: latched at the end", state.latch.is_some());
        let received: Vec<_> =
            world.device.received().iter().map(|frame| encode_raw(frame.id, &frame.payload)).collect();
        let mut outcomes = BTreeMap::new();
        for admitted in &world.clients.admitted {
            let command = admitted.ticket.now();
            let outcome = command.outcome.expect("the command has ended");
            *outcomes.entry(format!("outcome: {outcome:?}")).or_insert(0) += 1;
            let Some(motion) = &admitted.motion else { continue };
            if motion.id() == id::HOMING {
                continue;
            }
            let frame = encode(motion);
            let sent = world.invariants.motions.contains_key(&frame);
            match outcome {
                // A result of the device requires that the device received the frame.
                Outcome::Success | Outcome::PartHeld | Outcome::NoPart | Outcome::Blocked | Outcome::Range => {
                    assert!(received.contains(&frame), "unknown_is_said: {command:#?}\n{}", world.tail());
                }
                Outcome::Refused if command.status_code.is_none() => {
                    // A retried request is a new command with the same frame.
                    let others = world.clients.admitted.iter().filter(|other| {
                        let other_command = other.ticket.now();
                        let unsent =
                            other_command.outcome == Some(Outcome::Refused) && other_command.status_code.is_none();
                        other.motion.as_ref() == Some(motion) && !unsent
                    });
                    let times = world.invariants.motions.get(&frame).copied().unwrap_or_default();
                    let excused = others.count();
                    assert!(times <= excused, "unknown_is_said: refused, but sent: {command:#?}\n{}", world.tail());
                }
                Outcome::Unknown => assert!(sent, "unknown_is_said: never sent: {command:#?}\n{}", world.tail()),
                _ => {}
            }
        }
        super::journal::Journal::check(world);
        Servos::at_rest(world);
        world.count("device: foreign motion", world.journal.foreign_motions > 0);
        world.count("journal: grip record", world.journal.grips > 0);
        let is_script = |admitted: &&Admitted| admitted.ticket.now().kind == Kind::Custom;
        let scripts = world.clients.admitted.iter().filter(is_script).count();
        world.count("command: custom", scripts > 0);
        for (name, count) in outcomes {
            *world.counts.entry(name).or_default() += count;
        }
        for outcome in ["Success", "PartHeld", "NoPart", "Aborted", "Refused", "Unknown"] {
            world.counts.entry(format!("outcome: {outcome}")).or_default();
        }
    }

    /// Checks the frames of an orderly disconnect.
    pub fn drained(world: &mut World, received_before: u64) {
        let new = (world.device.snapshot().received_frames - received_before) as usize;
        let all = world.device.received();
        let frames: Vec<_> = all[all.len() - new.min(all.len())..].iter().map(|frame| frame.id).collect();
        let first = frames.iter().position(|&id| id == id::DISCONNECT_ANNOUNCEMENT);
        if world.interface != Interface::Tcp {
            assert!(first.is_none() && !world.device.snapshot().moving, "{frames:02X?}\n{}", world.tail());
            return;
        }
        assert_eq!(first, frames.len().checked_sub(1), "announce_before_close: {frames:02X?}\n{}", world.tail());
    }
}

/// Whether a FAST STOP is latched that a client requested.
fn is_requested(state: &State) -> bool {
    state.latch.as_ref().is_some_and(|latch| &*latch.fast_stop_by != "device")
}

fn encode(command: &Command) -> Vec<u8> {
    let mut frame = Vec::new();
    command.encode(&mut frame);
    frame
}

fn encode_raw(id: u8, payload: &[u8]) -> Vec<u8> {
    let mut frame = Vec::new();
    wsg::frame::encode(id, payload, &mut frame);
    frame
}
