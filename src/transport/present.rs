//! Serial ports and CAN interfaces of this machine, for errors about missing ones.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use url::Url;

/// Limit of listed names, so that the list does not bury the rest of the message.
const MAX_LISTED: usize = 12;

/// Names of serial ports on Linux, pluggable ones first: USB to serial, USB modems, ARM, i.MX, OMAP, Tegra, Bluetooth,
/// on-board.
const SERIAL_NAMES: [&str; 8] = ["ttyUSB", "ttyACM", "ttyAMA", "ttymxc", "ttyO", "ttyTHS", "rfcomm", "ttyS"];

/// Kernel's type of a port without hardware (`PORT_UNKNOWN`).
const NO_HARDWARE: &str = "0";

/// Kernel's type of a CAN interface (`ARPHRD_CAN`).
const CAN_HARDWARE: &str = "280";

/// Bit `IFF_UP` of an interface's flags.
const UP: u32 = 1;

/// Returns the URLs of this machine's serial ports, each by its stable name, and of its CAN interfaces that are up,
/// with the usual settings of devices.
#[must_use]
pub fn available() -> Vec<String> {
    let mut seen = BTreeSet::new();
    let ports = ports(Path::new("/dev"), Path::new("/sys/class/tty")).into_iter();
    let ports = ports.filter(|port| fs::canonicalize(port).is_ok_and(|device| seen.insert(device)));
    let ports = ports.map(|port| serial_url(&port));
    let interfaces = names(Path::new(INTERFACES)).into_iter().filter(|name| is_can(name) && is_up(name));
    ports.chain(interfaces.map(|name| format!("can://{name}"))).collect()
}

/// URL of a serial port, with special characters percent-encoded.
pub(super) fn serial_url(path: &str) -> String {
    let file = Url::from_file_path(path);
    format!("serial://{}", file.as_ref().map_or(path, Url::path))
}

/// E.g. "available: /dev/ttyUSB0, /dev/ttyS0".
pub(super) fn serial_ports() -> String {
    let ports = ports(Path::new("/dev"), Path::new("/sys/class/tty"));
    list("no serial port found: check that the adapter is plugged in", ports)
}

/// Lists ports by their stable ids first, then all ports by their numbers.
fn ports(devices: &Path, classes: &Path) -> Vec<String> {
    let by_id = devices.join("serial/by-id");
    let mut ports: Vec<_> = names(&by_id).iter().map(|name| by_id.join(name)).collect();
    let all = names(devices);
    for kind in SERIAL_NAMES {
        let found = all.iter().filter(|name| is_numbered(name, kind) && has_hardware(classes, name));
        ports.extend(found.map(|name| devices.join(name)));
    }
    ports.iter().map(|port| port.display().to_string()).collect()
}

/// Whether a port's name is this kind and a number, e.g. ttyS0.
fn is_numbered(name: &str, kind: &str) -> bool {
    let number = name.strip_prefix(kind).unwrap_or_default();
    !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
}

fn has_hardware(classes: &Path, port: &str) -> bool {
    text(&classes.join(port).join("type")).as_deref() != Some(NO_HARDWARE)
}

/// E.g. "available: can0 (down), vcan0".
pub(super) fn can_interfaces() -> String {
    let interfaces = names(Path::new(INTERFACES)).into_iter().filter(|name| is_can(name));
    let described = interfaces.map(|name| if is_up(&name) { name } else { format!("{name} (down)") });
    list("no CAN interface found: check that the adapter is plugged in and its driver loaded", described.collect())
}

const INTERFACES: &str = "/sys/class/net";

/// Whether a CAN interface of this name exists.
pub(super) fn is_can(name: &str) -> bool {
    attribute(name, "type").is_some_and(|hardware| hardware == CAN_HARDWARE)
}

pub(super) fn is_up(name: &str) -> bool {
    let flags = attribute(name, "flags");
    let flags = flags.and_then(|flags| u32::from_str_radix(flags.trim_start_matches("0x"), 16).ok());
    flags.is_some_and(|flags| flags & UP != 0)
}

/// Whether an interface has no hardware.
pub(super) fn is_virtual(name: &str) -> bool {
    !Path::new(INTERFACES).join(name).join("device").exists()
}

fn attribute(interface: &str, name: &str) -> Option<String> {
    text(&Path::new(INTERFACES).join(interface).join(name))
}

fn text(file: &Path) -> Option<String> {
    Some(fs::read_to_string(file).ok()?.trim().to_owned())
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
    format!("available: {}{and_more}", names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_pluggable_ports_first_and_omits_ports_without_hardware() {
        let root = std::env::temp_dir().join(format!("wsg-ports-{}", std::process::id()));
        let file = |path: &str, text: &str| {
            let path = root.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        for number in 0..32 {
            file(&format!("dev/ttyS{number}"), "");
            file(&format!("sys/ttyS{number}/type"), if number == 4 { "4\n" } else { "0\n" });
        }
        for name in ["serial/by-id/usb-FTDI-if00", "ttyUSB0", "ttyACM1", "ttyAMA0", "tty1", "ttyUSB", "ttyS", "null"] {
            file(&format!("dev/{name}"), "");
        }
        let found = ports(&root.join("dev"), &root.join("sys"));
        let beginning = format!("{}/", root.join("dev").display());
        let found: Vec<_> = found.iter().map(|port| port.strip_prefix(&beginning).unwrap()).collect();
        assert_eq!(found, ["serial/by-id/usb-FTDI-if00", "ttyUSB0", "ttyACM1", "ttyAMA0", "ttyS4"]);
        fs::remove_dir_all(root).unwrap();
    }
}
