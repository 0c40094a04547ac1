//! State and bit rate of CAN interfaces.

use std::process::Command;

use serde::Deserialize;

use super::Diagnosis;
use crate::transport::CanAddress;

/// An interface as `ip -json -details link show` describes it.
#[derive(Deserialize)]
struct Interface {
    flags: Vec<String>,
    #[serde(default)]
    linkinfo: LinkInfo,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct LinkInfo {
    info_data: InfoData,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct InfoData {
    state: Option<String>,
    bittiming: Option<BitTiming>,
}

#[derive(Deserialize)]
struct BitTiming {
    bitrate: u32,
}

/// Returns a problem of the interface. A missing one is found when it is opened.
pub(super) fn check(address: &CanAddress) -> Option<Diagnosis> {
    let shown = Command::new("ip").args(["-json", "-details", "link", "show", "dev", &address.interface]).output();
    judge(address, &shown.ok()?.stdout)
}

fn judge(address: &CanAddress, shown: &[u8]) -> Option<Diagnosis> {
    let [interface] = serde_json::from_slice::<[Interface; 1]>(shown).ok()?;
    let CanAddress { interface: name, bitrate, .. } = address;
    let InfoData { state, bittiming } = interface.linkinfo.info_data;
    // A virtual interface has no bit rate.
    let settings = if bittiming.is_some() || state.is_some() {
        format!(" type can bitrate {bitrate} restart-ms 100")
    } else {
        String::new()
    };
    let up = format!("sudo ip link set {name} up{settings}");
    let down = format!("sudo ip link set {name} down");
    if !interface.flags.iter().any(|flag| flag == "UP") {
        return Some(Diagnosis::problem("CAN interface", format_args!("{name} is down: run `{up}`")));
    }
    if let Some(wrong) = bittiming.filter(|timing| timing.bitrate != *bitrate) {
        let text = format!(
            "{name} has the bit rate {}, but the gripper's URL says {bitrate}: run `{down} && {up}`, or write \
             bitrate={0} in the URL; the gripper needs the same bit rate",
            wrong.bitrate
        );
        return Some(Diagnosis::problem("CAN interface", text));
    }
    match state.as_deref() {
        Some("BUS-OFF") => Some(Diagnosis::problem(
            "CAN interface",
            format_args!(
                "{name} is bus-off: compare the bit rates, check cable and termination, then run `{down} && {up}`"
            ),
        )),
        Some(state @ ("ERROR-WARNING" | "ERROR-PASSIVE")) => Some(Diagnosis::warning(
            "CAN interface",
            format_args!("{name} counts many errors ({state}): compare the bit rates, check cable and termination"),
        )),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::Severity;
    use super::*;

    fn finding(flags: &str, data: &str) -> Option<Diagnosis> {
        let crate::transport::Address::Can(address) = "can://can0?bitrate=500000".parse().unwrap() else { panic!() };
        let shown = format!(r#"[{{"ifname":"can0","flags":[{flags}],"linkinfo":{{"info_data":{data}}}}}]"#);
        judge(&address, shown.as_bytes())
    }

    #[test]
    fn down_bus_off_and_wrong_bit_rate_are_problems() {
        let up = r#""NOARP","UP","LOWER_UP""#;
        let right = r#"{"state":"ERROR-ACTIVE","bittiming":{"bitrate":500000,"sample_point":"0.875"}}"#;
        assert_eq!(finding(up, right), None);
        assert_eq!(finding(up, "{}"), None, "a virtual interface has no bit rate");
        for (flags, data, expected) in [
            (r#""NOARP""#, right, "down: run `sudo ip link set can0 up type can bitrate 500000 restart-ms 100`"),
            (r#""NOARP""#, "{}", "can0 is down: run `sudo ip link set can0 up`"),
            (up, &right.replace("500000", "250000"), "can0 has the bit rate 250000, but the gripper's URL says 500000"),
            (up, &right.replace("ERROR-ACTIVE", "BUS-OFF"), "can0 is bus-off: compare the bit rates"),
        ] {
            let finding = finding(flags, data).unwrap();
            assert!(finding.severity == Severity::Problem && finding.text.contains(expected), "{finding}");
        }
        assert_eq!(finding(up, &right.replace("ACTIVE", "PASSIVE")).unwrap().severity, Severity::Warning);
    }
}
