//! The arrows between the rooms, and what no file may have: read from the sources, so that a line against them fails
//! here and not in a review.

mod source;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use source::Source;

/// The longest file that a reader is asked to read.
const MAX_LINES: usize = 500;

/// What each room may name of the others. `cli`, `lib.rs` and `main.rs` may name everything.
const ARROWS: &[(&str, &[&str])] = &[
    ("wsg", &[]),
    ("transport", &[]),
    ("logging", &[]),
    ("sim", &["wsg"]),
    ("gripper", &["transport", "wsg"]),
    ("journal", &["gripper::model", "gripper::recorder"]),
    ("fleet", &["gripper"]),
    ("events", &["gripper", "journal", "fleet"]),
    ("operations", &["gripper", "journal", "fleet", "events", "wsg"]),
    ("interfaces", &["operations", "events", "fleet", "gripper", "journal", "wsg"]),
    ("config", &["transport", "gripper::model"]),
    (
        "daemon",
        &[
            "wsg",
            "transport",
            "gripper",
            "operations",
            "interfaces",
            "fleet",
            "events",
            "journal",
            "sim",
            "config",
            "logging",
        ],
    ),
];

/// What is below the protocol's values: the bytes, and what is in flight.
const FRAMES: &[&str] = &[
    "wsg::frame",
    "wsg::crc",
    "wsg::Frame",
    "wsg::Decoder",
    "wsg::Decoded",
    "wsg::DecoderCounters",
    "wsg::ChecksumEvaluation",
];
const SESSION: &[&str] = &["wsg::session"];

/// Who may use the frames, and who the session.
const FRAME_USERS: &[&str] = &["wsg/", "sim/", "gripper/driver.rs", "gripper/actor/", "interfaces/wsg_port", "cli"];
const SESSION_USERS: &[&str] = &["wsg/", "gripper/driver.rs", "gripper/actor/", "gripper/latch.rs", "gripper/setup.rs"];

/// What the machines may not have, since bytes and `now` come from outside.
const MACHINES: &[&str] = &["wsg", "sim"];
const OF_THE_WORLD: &[&str] = &["Instant::now", "SystemTime", "tokio", "rand::", "std::net", "std::fs", "std::env"];

fn begins(name: &str, prefix: &str) -> bool {
    name.strip_prefix(prefix).is_some_and(|rest| rest.is_empty() || rest.starts_with("::"))
}

fn against_arrows(source: &Source) -> Vec<String> {
    let room = source.room();
    let allowed = ARROWS.iter().find(|(name, _)| *name == room).map(|(_, allowed)| *allowed);
    let mut found = Vec::new();
    for name in source.names() {
        let stays = begins(&name, &room) || !name.contains(|character: char| character.is_lowercase());
        if !stays && allowed.is_some_and(|allowed| !allowed.iter().any(|allowed| begins(&name, allowed))) {
            found.push(format!("src/{}: {room} must not import {name}", source.path));
        }
        for (what, users) in [(FRAMES, FRAME_USERS), (SESSION, SESSION_USERS)] {
            let uses = what.iter().any(|what| begins(&name, what));
            if uses && !users.iter().any(|user| source.path.starts_with(user)) {
                found.push(format!("src/{}: {name} is for {users:?} alone", source.path));
            }
        }
    }
    found
}

fn against_house_rules(source: &Source) -> Vec<String> {
    let mut found = Vec::new();
    for line in source.code.lines() {
        let item = line.trim_start();
        let item =
            item.strip_prefix("pub").map_or(item, |rest| rest.trim_start_matches(|c: char| c != ' ').trim_start());
        let rules = [
            (line.contains(".unwrap()"), "unwrap() belongs in tests"),
            (line.contains("unsafe ") || line.contains("unsafe{"), "no unsafe"),
            // An allocator is declared by a static, and holds no state of ours.
            (item.starts_with("static ") && !item.starts_with("static ALLOCATOR:"), "no statics: state has an owner"),
            (has_unnamed_limit(line), "a queue has a limit, and a name for it"),
        ];
        found.extend(rules.iter().filter(|(broken, _)| *broken).map(|(_, rule)| (line, *rule)));
        if MACHINES.contains(&source.room().as_str()) && OF_THE_WORLD.iter().any(|what| line.contains(what)) {
            found.push((line, "a machine has no clock, no runtime, no chance and no files"));
        }
    }
    found.into_iter().map(|(line, rule)| format!("src/{}: {rule}: {}", source.path, line.trim())).collect()
}

/// Whether a queue is made here without a limit, or with one that has no name. One or none needs none.
fn has_unnamed_limit(line: &str) -> bool {
    let is_named = |limit: &str| {
        let limit = limit.split(')').next().unwrap_or_default();
        limit.split(" + ").all(|word| {
            let word = word.rsplit("::").next().unwrap_or_default();
            word == "1" || !word.is_empty() && word.chars().all(|c| c.is_ascii_uppercase() || c == '_')
        })
    };
    let made = ["mpsc::channel(", "broadcast::channel(", "broadcast::Sender::new(", "sync_channel("];
    let limits = made.iter().filter_map(|made| line.split_once(made));
    line.contains("unbounded") || limits.map(|(_, limit)| limit).any(|limit| !is_named(limit))
}

fn files(below: &Path) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut directories = vec![below.to_owned()];
    while let Some(directory) = directories.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                directories.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(below).unwrap().to_str().unwrap().to_owned();
                found.push((name, fs::read_to_string(path).unwrap()));
            }
        }
    }
    found
}

fn below_root(directory: &str) -> Vec<(String, String)> {
    files(&Path::new(env!("CARGO_MANIFEST_DIR")).join(directory))
}

/// The sources that are compiled outside of tests.
fn sources() -> Vec<Source> {
    let all: Vec<_> = below_root("src").iter().map(|(path, text)| Source::new(path, text)).collect();
    let test_files: Vec<_> = all.iter().flat_map(|source| source.test_files.clone()).collect();
    let is_test = |source: &Source| {
        test_files.iter().any(|test| {
            source
                .path
                .strip_prefix(test.trim_end_matches(".rs"))
                .is_some_and(|rest| rest == ".rs" || rest.starts_with('/'))
        })
    };
    all.into_iter().filter(|source| !is_test(source)).collect()
}

fn violations(rules: fn(&Source) -> Vec<String>) -> Vec<String> {
    sources().iter().flat_map(rules).collect()
}

#[test]
fn imports_follow_the_arrows() {
    assert_eq!(violations(against_arrows), Vec::<String>::new());
}

#[test]
fn the_house_rules_hold() {
    assert_eq!(violations(against_house_rules), Vec::<String>::new());
}

#[test]
fn every_room_has_its_arrows() {
    let mut rooms: BTreeMap<_, usize> = BTreeMap::new();
    for source in sources() {
        *rooms.entry(source.room()).or_default() += source.names().len();
    }
    for (room, names) in rooms {
        assert!(ARROWS.iter().any(|(known, _)| *known == room) || matches!(room.as_str(), "" | "cli"), "{room}");
        // A reader of sources that finds no imports would hold any rule.
        assert!(names > 0 || matches!(room.as_str(), "logging"), "no import of {room} was read");
    }
}

#[test]
fn no_file_is_longer_than_its_reader() {
    for (path, text) in ["src", "tests"].into_iter().flat_map(below_root) {
        let lines = text.lines().count();
        assert!(lines <= MAX_LINES, "{path} has {lines} lines, and {MAX_LINES} are the limit: split it");
    }
}

#[test]
fn a_line_against_a_rule_is_found() {
    for (path, text) in [
        ("wsg/frame.rs", "use crate::gripper::model::Name;"),
        ("wsg/session/mod.rs", "use super::super::sim::Device;"),
        ("transport/tcp.rs", "fn f() { crate::wsg::id::name(1); }"),
        ("sim/link.rs", "use crate::wsg::{Status, session::{self, Session}};"),
        ("sim/link.rs", "use crate::{\n    wsg,\n    transport::Pipe,\n};"),
        ("gripper/handle.rs", "use crate::wsg::session::Token;"),
        ("gripper/model.rs", "use crate::interfaces::http;"),
        ("gripper/info.rs", "use crate::wsg::{\n    Decoder,\n    Status as DeviceStatus,\n};"),
        ("interfaces/http/raw.rs", "use crate::wsg::frame::encode;"),
        ("interfaces/http/raw.rs", "use super::super::super::daemon;"),
        ("config.rs", "use crate::gripper::Handle;"),
        ("daemon/simulation.rs", "use crate::wsg::frame;"),
        ("daemon/mod.rs", "use crate::cli;"),
    ] {
        assert_ne!(against_arrows(&Source::new(path, text)), Vec::<String>::new(), "{path}: {text}");
    }
    for (path, text) in [
        ("wsg/session/mod.rs", "let now = Instant::now();"),
        ("sim/mod.rs", "use tokio::time::sleep;"),
        ("gripper/handle.rs", "let name = text.parse().unwrap();"),
        ("cli.rs", "pub(crate) static COUNT: AtomicU64 = AtomicU64::new(0);"),
        ("cli.rs", "let pid = unsafe { getpid() };"),
        ("gripper/driver.rs", "let (a, b) = mpsc::unbounded_channel();"),
        ("gripper/driver.rs", "let (a, b) = mpsc::channel(64);"),
        ("journal/mod.rs", "let (a, b) = sync_channel(QUEUE + 2);"),
    ] {
        assert_ne!(against_house_rules(&Source::new(path, text)), Vec::<String>::new(), "{path}: {text}");
    }
}

#[test]
fn what_keeps_the_rules_and_what_only_tests_compile_is_left_alone() {
    let kept = "use crate::wsg::{self, Data, Status};\nuse super::errors::Problem;\n// crate::daemon::run\n";
    let tests = "#[cfg(test)]\nmod tests {\n    use crate::daemon;\n    fn f() { x.unwrap() }\n}\n";
    let source = Source::new("interfaces/http/raw.rs", &format!("{kept}{tests}const A: &'static str = \"\";\n"));
    assert_eq!(against_arrows(&source), Vec::<String>::new());
    assert_eq!(against_house_rules(&source), Vec::<String>::new());
    let elsewhere = "#[cfg(test)]\n#[path = \"errors_tests.rs\"]\nmod tests;\n#[cfg(test)]\npub(crate) mod fake;\n";
    let source = Source::new("gripper/mod.rs", elsewhere);
    assert_eq!(source.test_files, ["gripper/errors_tests.rs", "gripper/fake"]);
}
