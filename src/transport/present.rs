//! What serial ports and CAN interfaces this machine has, for whoever named one that it hasn't.

use std::fs;
use std::path::Path;

/// So many are listed at most: more would hide the message that they are a part of.
const MAX_LISTED: usize = 12;

/// What serial ports are called on Linux: on-board, USB to serial, USB modems, ARM, i.MX, OMAP, Tegra, Bluetooth.
const SERIAL_NAMES: [&str; 8] = ["ttyS", "ttyUSB", "ttyACM", "ttyAMA", "ttymxc", "ttyO", "ttyTHS", "rfcomm"];

/// The kernel's number for a CAN interface (`ARPHRD_CAN`).
const CAN_HARDWARE: &str = "280";

/// IFF_UP, in an interface's flags.
const UP: u32 = 1;

/// E.g. "there are: /dev/ttyS0, /dev/ttyUSB0".
pub(super) fn serial_ports() -> String {
    let is_port = |name: &String| {
        let number = SERIAL_NAMES.iter().find_map(|kind| name.strip_prefix(kind));
        number.is_some_and(|number| !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let ports = names(Path::new("/dev")).into_iter().filter(is_port).map(|name| format!("/dev/{name}"));
    let by_id = names(Path::new("/dev/serial/by-id")).into_iter().map(|name| format!("/dev/serial/by-id/{name}"));
    list("no serial port is there: is the adapter plugged in?", by_id.chain(ports).collect())
}

/// E.g. "there are: can0 (down), vcan0".
pub(super) fn can_interfaces() -> String {
    let interfaces = names(Path::new(INTERFACES)).into_iter().filter(|name| is_can(name));
    let described = interfaces.map(|name| if is_up(&name) { name } else { format!("{name} (down)") });
    list("no CAN interface is there: is the adapter plugged in, and its driver loaded?", described.collect())
}

const INTERFACES: &str = "/sys/class/net";

/// Whether there is a CAN interface of this name.
pub(super) fn is_can(name: &str) -> bool {
    attribute(name, "type").is_some_and(|hardware| hardware == CAN_HARDWARE)
}

/// Whether an interface is up.
pub(super) fn is_up(name: &str) -> bool {
    let flags = attribute(name, "flags");
    let flags = flags.and_then(|flags| u32::from_str_radix(flags.trim_start_matches("0x"), 16).ok());
    flags.is_some_and(|flags| flags & UP != 0)
}

/// Whether there is no hardware behind an interface.
pub(super) fn is_virtual(name: &str) -> bool {
    !Path::new(INTERFACES).join(name).join("device").exists()
}

fn attribute(interface: &str, name: &str) -> Option<String> {
    let text = fs::read_to_string(Path::new(INTERFACES).join(interface).join(name)).ok()?;
    Some(text.trim().to_owned())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}

fn list(none: &str, mut names: Vec<String>) -> String {
    if names.is_empty() {
        return none.to_owned();
    }
    let more = names.len().saturating_sub(MAX_LISTED);
    names.truncate(MAX_LISTED);
    let and_more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("there are: {}{and_more}", names.join(", "))
}
