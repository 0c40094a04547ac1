use jiff::Timestamp;

use super::*;
use model::{Action, Door, IdSource, Motion, RequestId};
use wsg::HomingDirection;

fn home() -> Action {
    Action::Motion(Motion::Home(HomingDirection::Default))
}

fn submission(subject: &str, action: Action, request_id: Option<&str>) -> Submission {
    let client = Client::new(subject, Door::Http);
    let request_id = request_id.and_then(RequestId::new);
    Submission { client, action, request_id, lease: None }
}

/// A registry with its clocks. The wall clock behind the ids runs backwards, since no order may depend on it.
struct Desk {
    commands: CommandRegistry,
    now: Instant,
    ids: i64,
}

impl Desk {
    fn new() -> Self {
        Self { commands: CommandRegistry::default(), now: Instant::now(), ids: 1_000_000_000 }
    }

    fn admit(&mut self, submission: &Submission) -> CommandId {
        self.ids -= 1;
        let id = IdSource::new(1).command_id(Timestamp::from_millisecond(self.ids).unwrap());
        let command = CommandReport::admitted(id, "g".parse().unwrap(), submission, Timestamp::UNIX_EPOCH);
        self.commands.enter(self.now, command, submission, false);
        self.commands.recorded(id);
        id
    }

    fn end(&mut self, id: CommandId, outcome: Outcome) {
        self.commands.end(self.now, id, |command| command.set_outcome(outcome));
        self.commands.notify();
    }

    fn run(&mut self, subject: &str, action: Action, request_id: Option<&str>) -> CommandId {
        let id = self.admit(&submission(subject, action, request_id));
        self.end(id, Outcome::Success);
        id
    }

    /// The command that answers a repeated request.
    fn replayed(&self, subject: &str, action: Action, request_id: &str) -> Option<CommandId> {
        let replay = self.commands.replay(self.now, &submission(subject, action, Some(request_id))).unwrap();
        replay.map(|ticket| ticket.id())
    }

    fn has_room(&mut self, subject: &str) -> bool {
        self.commands.check_room(self.now, &submission(subject, home(), Some("one more"))).is_ok()
    }
}

#[test]
fn request_ids_outlive_their_commands_in_the_registry() {
    let mut desk = Desk::new();
    let first = desk.run("test", home(), Some("r1"));
    for _ in 0..=MAX_MOTIONS {
        desk.run("test", home(), None);
    }
    assert!(desk.commands.find(first).is_none() && desk.commands.commands.len() <= MAX_MOTIONS);
    desk.now += REPLAYED_FOR / 2;
    assert_eq!(desk.replayed("test", home(), "r1"), Some(first));
    desk.now += REPLAYED_FOR / 2;
    assert_eq!(desk.replayed("test", home(), "r1"), None);
}

#[test]
fn request_ids_are_bounded_and_never_forgotten_early() {
    let mut desk = Desk::new();
    let limit = MOTION_IDS.per_subject;
    let ids: Vec<_> = (0..limit).map(|number| desk.run("test", home(), Some(&number.to_string()))).collect();
    let one_more = submission("test", home(), Some("one more"));
    assert_eq!(desk.commands.check_room(desk.now, &one_more), Err(Failure::RequestIds { limit }));
    assert!(desk.commands.check_room(desk.now, &submission("test", home(), None)).is_ok());
    assert_eq!(desk.replayed("test", home(), "0"), Some(ids[0]));
    assert!(desk.has_room("another"), "the bound is the subject's own");
    desk.now += REPLAYED_FOR;
    assert!(desk.has_room("test"));
    assert_eq!(desk.replayed("test", home(), "0"), None);
}

#[test]
fn invented_subjects_push_out_no_request_ids_of_others() {
    let mut desk = Desk::new();
    let own = desk.run("holder", home(), Some("r1"));
    for number in 0..2 * MOTION_IDS.whole {
        let subject = format!("invented {}", number % 8);
        desk.run(&subject, home(), Some(&number.to_string()));
        assert!(number % 1000 != 0 || desk.has_room("holder"));
    }
    assert_eq!(desk.replayed("holder", home(), "r1"), Some(own));
    let next = desk.run("holder", home(), Some("r2"));
    assert_eq!(desk.replayed("holder", home(), "r1"), Some(own));
    assert_eq!(desk.replayed("holder", home(), "r2"), Some(next));
}

#[test]
fn stops_with_ids_take_no_slots_of_motions() {
    let mut desk = Desk::new();
    let motion = desk.run("holder", home(), Some("r1"));
    let stop = desk.run("holder", Action::Stop, Some("s1"));
    for number in 0..100_000 {
        desk.run("flood", Action::Stop, Some(&number.to_string()));
    }
    assert!(desk.has_room("flood") && desk.has_room("holder"));
    assert_eq!(desk.replayed("holder", home(), "r1"), Some(motion));
    assert_eq!(desk.replayed("holder", Action::Stop, "s1"), Some(stop));
    assert!(desk.replayed("flood", Action::Stop, "99999").is_some());
    assert_eq!(desk.replayed("flood", Action::Stop, "0"), None, "the oldest is dropped");
}

#[test]
fn stops_push_no_motion_out_of_the_history() {
    let mut desk = Desk::new();
    let ended = desk.run("holder", home(), None);
    let running = desk.admit(&submission("holder", home(), None));
    for _ in 0..2 * MAX_MOTIONS {
        desk.run("flood", Action::Stop, None);
    }
    assert!(desk.commands.find(ended).is_some() && desk.commands.find(running).is_some());
    assert!(desk.commands.commands.len() <= MAX_STOPS + 2, "{} commands", desk.commands.commands.len());
}

#[test]
fn running_motions_are_never_forgotten() {
    let mut desk = Desk::new();
    let running = desk.admit(&submission("holder", home(), None));
    for _ in 0..2 * MAX_MOTIONS {
        desk.run("other", home(), None);
    }
    assert!(desk.commands.commands.len() <= MAX_MOTIONS, "{} commands", desk.commands.commands.len());
    assert_eq!(desk.commands.find(running).unwrap().now().phase, Phase::Running);
    desk.end(running, Outcome::Success);
    desk.now += KEPT_FOR;
    let newest = desk.run("other", home(), None);
    assert_eq!(desk.commands.commands.len(), 1);
    assert!(desk.commands.find(newest).is_some());
}

#[test]
fn refused_requests_bind_nothing() {
    let mut desk = Desk::new();
    let refused = desk.admit(&submission("test", home(), Some("r1")));
    desk.end(refused, Outcome::Refused);
    assert_eq!(desk.replayed("test", home(), "r1"), None);
}

#[test]
fn script_replies_take_slots_by_size() {
    let mut desk = Desk::new();
    let answer: Arc<str> = "00".repeat(4096).into();
    for number in 0..MOTION_IDS.per_subject {
        let id = desk.admit(&submission("test", home(), Some(&number.to_string())));
        desk.commands.end(desk.now, id, |command| command.payload = Some(answer.clone()));
        desk.commands.notify();
        if !desk.has_room("test") {
            assert!((MOTION_IDS.per_subject / 6..MOTION_IDS.per_subject / 4).contains(&number), "after {number}");
            return;
        }
    }
    panic!("replies of 8 KiB are not counted");
}

#[test]
fn slots_are_large_enough() {
    let tables = 6 * size_of::<Key>() + size_of::<(Kind, Parameters)>();
    // Besides the command: the contents of its strings, and a watch channel.
    assert!(tables + size_of::<CommandReport>() + 512 < 2048);
}
