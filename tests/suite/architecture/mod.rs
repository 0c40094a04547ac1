//! Architecture test: which room of `src` can use which, and house rules for every file.

mod code;
mod idioms;
mod pinned;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use petgraph::algo::astar;
use petgraph::graphmap::DiGraphMap;
use walkdir::WalkDir;

use code::Code;

/// Every room, and the rooms that it uses. A room is a folder, or a file without `.rs`, below `src`. A file belongs to
/// the room with the longest matching name.
const ROOMS: &str = "
    lib:
    access: model settings
    main: cli
    cli: access config connections daemon doctor fleet interfaces interfaces/http interfaces/websocket model journal logging
        transport wsg wsg/frame
    alarms: access fleet gripper model gripper/recorder journal wear webhooks
    daemon: access alarms config connections interfaces interfaces/dashboard interfaces/http interfaces/modbus interfaces/mqtt
        interfaces/wsg_port interfaces/zenoh events fleet operations gripper gripper/actor model gripper/recorder journal recipes
        settings sim transport trends wear webhooks wsg
    doctor: access config connections daemon model interfaces/mqtt interfaces/wsg_port journal transport wsg wsg/frame
    config: access connections model interfaces/http interfaces/mqtt interfaces/wsg_port journal settings transport wear webhooks
    logging:
    operations: access alarms events fleet gripper model gripper/recorder journal recipes trends wear webhooks wsg
    connections: access model settings transport
    interfaces: connections operations
    interfaces/dashboard: interfaces operations
    interfaces/http: access connections interfaces interfaces/dashboard interfaces/websocket events fleet operations
        gripper model journal recipes settings transport
    interfaces/modbus: connections gripper model operations wsg
    interfaces/mqtt: access alarms connections fleet gripper model gripper/recorder journal operations settings transport
        webhooks
    interfaces/websocket: access connections interfaces events gripper model operations
    interfaces/wsg_port: access connections gripper model operations settings wsg wsg/frame
    interfaces/zenoh: access connections interfaces events fleet gripper model journal operations
    events: alarms fleet gripper model journal
    fleet: gripper model
    journal: model gripper/recorder
    gripper: gripper/actor model gripper/recorder transport wsg
    gripper/actor: gripper gripper/latch model gripper/recorder gripper/setup transport
        wsg wsg/frame wsg/session
    gripper/latch: gripper model wsg wsg/session
    model: settings wsg
    gripper/recorder: model
    gripper/setup: wsg wsg/session
    recipes: model gripper/recorder journal
    settings:
    sim: wsg wsg/frame
    transport:
    trends: gripper model
    wear: model gripper/recorder journal settings
    webhooks: model gripper/recorder journal transport
    wsg: wsg/crc wsg/frame
    wsg/crc:
    wsg/frame: wsg/crc
    wsg/session: wsg wsg/frame
";

/// Rooms without import cycles, neither within a room nor across these rooms.
const WITHOUT_CIRCLES: &str = "
    lib access main cli logging operations alarms fleet recipes trends wear
    connections interfaces interfaces/dashboard interfaces/http interfaces/modbus interfaces/mqtt interfaces/websocket interfaces/wsg_port interfaces/zenoh
    gripper gripper/latch gripper/recorder gripper/setup transport wsg wsg/crc wsg/frame
";

/// Further rooms without cycles within. Two rooms are missing, whose files cannot be put in order: in `sim`, the fingers and
/// the objects around them push one another; in `journal`, the store and what it keeps use each other's tables.
const WITHOUT_CIRCLES_WITHIN: &str = "config daemon doctor events gripper/actor model settings webhooks wsg/session";

/// Rooms that get bytes and `now` from outside, and the names that they must not use.
const MACHINES: &[&str] = &["wsg", "sim"];
const WORLD: &[&str] = &["Instant::now", "SystemTime", "tokio", "rand::", "std::net", "std::fs", "std::env"];

/// Maximum lines of a file.
const MAX_LINES: usize = 500;

/// Returns each room of a table paired with itself, and with every room that it uses.
fn arrows(table: &str) -> BTreeSet<(&str, &str)> {
    let (mut arrows, mut room) = (BTreeSet::new(), "");
    for word in table.split_whitespace() {
        room = word.strip_suffix(':').unwrap_or(room);
        arrows.insert((room, word.trim_end_matches(':')));
    }
    arrows
}

fn is_in(file: &str, place: &str) -> bool {
    file.strip_prefix(place).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

fn room<'a>(arrows: &BTreeSet<(&'a str, &'a str)>, file: &str) -> &'a str {
    let rooms = arrows.iter().map(|(room, _)| *room).filter(|room| is_in(file, room));
    rooms.max_by_key(|room| room.len()).unwrap_or("no room")
}

fn against_rooms(code: &Code, table: &str) -> Vec<String> {
    let arrows = arrows(table);
    let (mut found, mut unused) = (Vec::new(), arrows.clone());
    for (file, definer, name) in code.names() {
        let arrow @ (from, to) = (room(&arrows, file), room(&arrows, definer));
        unused.remove(&arrow);
        if !arrows.contains(&arrow) {
            found.push(format!("src/{file}.rs: room {from} must not use {to}: {name}"));
        }
    }
    found.extend(unused.iter().map(|(room, used)| format!("unused, remove it from ROOMS: {room} → {used}")));
    found
}

/// Whether a file is a part of the module that this other file begins. A part can use what its whole defines.
fn is_part(file: &str, whole: &str) -> bool {
    let whole = whole.strip_suffix("/mod").unwrap_or(whole);
    file != whole && is_in(file, whole)
}

/// Returns the shortest import cycle among the files of some rooms.
fn circle(code: &Code, table: &str, of: &str) -> Option<String> {
    let arrows = arrows(table);
    let unknown: Vec<_> = of.split_whitespace().filter(|name| !arrows.contains(&(*name, *name))).collect();
    assert!(unknown.is_empty(), "unknown rooms: {unknown:?}");
    let is_of = |file| of.split_whitespace().any(|name| name == room(&arrows, file));
    let used = code.names().filter(|(file, definer, _)| file != definer && !is_part(file, definer));
    let names = used.filter(|(file, definer, _)| is_of(file) && is_of(definer));
    let imports: DiGraphMap<_, _> = names.collect();
    let back = |(from, to, _)| Some(astar(&imports, to, |file| file == from, |_| 1, |_| 0)?.1);
    let files = imports.all_edges().filter_map(back).min_by_key(Vec::len)?;
    let (first, rest) = files.split_first()?;
    let steps = files.iter().zip(rest.iter().chain([first]));
    Some(steps.map(|(from, to)| format!("{from} → {to} ({})", imports[(*from, *to)])).collect::<Vec<_>>().join(", "))
}

fn against_house_rules(code: &Code) -> Vec<String> {
    let mut found = code.breaches.clone();
    for (file, _, name) in code.names() {
        let has = |part: &&str| format!("::{name}::").contains(&format!("::{part}"));
        if has(&"unbounded") {
            found.push(format!("src/{file}.rs: {name}: a queue needs a limit"));
        }
        if MACHINES.iter().any(|machine| is_in(file, machine)) && WORLD.iter().any(has) {
            found.push(format!("src/{file}.rs: {name}: a state machine has no clock, runtime, randomness or files"));
        }
    }
    found
}

fn texts(directory: &str) -> BTreeMap<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(directory);
    let files = WalkDir::new(&root).into_iter().map(|entry| entry.unwrap().into_path());
    let files = files.filter(|file| file.extension().is_some_and(|extension| extension == "rs"));
    let name = |file: &Path| file.strip_prefix(&root).unwrap().with_extension("").to_str().unwrap().to_owned();
    files.map(|file| (name(&file), fs::read_to_string(file).unwrap())).collect()
}

#[test]
fn code_keeps_its_rules() {
    let code = Code::new(texts("src"));
    let found = [against_rooms(&code, ROOMS), against_house_rules(&code)].concat();
    assert!(found.is_empty(), "{found:#?}");
    assert_eq!(circle(&code, ROOMS, WITHOUT_CIRCLES), None);
    for room in WITHOUT_CIRCLES_WITHIN.split_whitespace() {
        assert_eq!(circle(&code, ROOMS, room), None);
    }
    // rustc and clippy enforce two more rules.
    let lints = include_str!("../../../Cargo.toml");
    assert!(lints.contains("unsafe_code = \"forbid\"") && lints.contains("unwrap_used = \"warn\""));
}

#[test]
fn no_file_is_too_long() {
    for (file, text) in ["src", "tests"].into_iter().flat_map(texts) {
        let lines = text.lines().count();
        assert!(lines <= MAX_LINES, "{file}.rs has {lines} lines; the limit is {MAX_LINES}: split it");
    }
}

/// Returns a crate of two rooms, with these file contents.
fn planted(model: &str, wsg: &str) -> Code {
    let lib = ("lib", "mod fleet; mod wsg;");
    let files =
        [lib, ("main", ""), ("fleet/mod", "mod model; pub use model::Model;"), ("fleet/model", model), ("wsg", wsg)];
    Code::new(files.map(|(file, text)| (file.to_owned(), text.to_owned())).into())
}

#[test]
fn forbidden_import_is_found() {
    for wsg in [
        "use crate::fleet::Model;",
        "use super::{fleet::{self as g}};",
        "mod inner { use super::super::fleet::model::*; }",
        "fn f(_: Vec<super::fleet::Model>) {}",
        "fn f() { crate::fleet::f(1); }",
        "fn f() { info!(a = b, (crate::fleet::f::<u8>())); }",
        "#[derive(crate::fleet::Derive)] struct A;",
    ] {
        let found = against_rooms(&planted("", wsg), "lib: main: fleet: wsg:");
        assert!(found.len() == 1 && found[0].contains("wsg must not use fleet"), "{wsg}: {found:?}");
    }
}

#[test]
fn wrong_table_of_rooms_is_found() {
    let code = planted("", "");
    for table in ["lib: main: fleet: wsg: auth:", "lib: main: fleet: wsg wsg:", "lib: main: fleet:"] {
        assert_eq!(against_rooms(&code, table).len(), 1, "{table}");
    }
}

#[test]
fn cycle_is_found() {
    let found = |wsg| circle(&planted("fn g() { super::super::wsg::f() }", wsg), "lib: main: fleet: wsg:", "fleet wsg");
    let chain = "wsg → fleet/model (crate::fleet::Model), fleet/model → wsg (super::super::wsg::f)";
    assert_eq!(found("use crate::fleet::Model;").unwrap(), chain);
    assert_eq!(found("use crate::fleet::f;"), None);
}

#[test]
fn breach_of_a_house_rule_is_found() {
    for wsg in [
        "fn f() { let now = Instant::now(); }",
        "use std::{fs, mem};",
        "fn f() { tokio::select! {} }",
        "static COUNT: u8 = 0;",
        "pub struct A; mod b { pub(super) type A = u8; }",
        "fn f() { mpsc::unbounded_channel(); }",
        "fn f() { mpsc::channel::<u8>(64); }",
        "fn f() { sync_channel(QUEUE + 2); }",
    ] {
        assert_eq!(against_house_rules(&planted("", wsg)).len(), 1, "{wsg}");
    }
}

#[test]
fn test_code_is_ignored() {
    let tests = "fn f() { crate::fleet::f(tokio::spawn()); mpsc::channel(64) }";
    let code = planted(
        "fn f() { sync_channel(super::QUEUE + ENDS + 1); }",
        &format!("#[cfg(test)] mod tests; impl A {{ #[cfg(test)] {tests} }}"),
    );
    assert_eq!(
        [against_rooms(&code, "lib: main: fleet: wsg:"), against_house_rules(&code)].concat(),
        Vec::<String>::new()
    );
}
