//! Settings of Modbus TCP, which serves all grippers.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::time::Duration;

use ipnet::IpNet;
use toml::Spanned;

use super::{Config, ConfigError, ConfigPlace, File, Flags, GripperConfig, Placed, parse_address};
use crate::connections::networks::networks;
use crate::model::Name;
use crate::settings::{SettingValue, between, optional, optional_whole, settings, whole};

/// Unit identifiers of grippers; 0 and 255 are the gateway.
const UNITS: RangeInclusive<u8> = 1..=247;

settings! {
    pub(super) struct ModbusContent {
        /// Address of Modbus TCP; the same as `--modbus`. A port below 1024 needs a [capability](modbus.md#port-502).
        address: Option<Spanned<String>> = "modbus", optional("an address", "\"127.0.0.1:5020\""), Restart;
        group rules: ModbusRules;
    }
}

settings! {
    /// Rules for the clients of Modbus TCP.
    pub struct ModbusRules {
        /// Addresses that can connect to Modbus.
        // If empty: known clients and loopback, or every client if the gateway needs no credentials (see
        // `KnownPeers::allows`).
        pub allow: Vec<IpNet> = "modbus_allow", networks("see [Modbus](modbus.md#setup)", "[\"192.168.1.10\"]"), Reload;
        /// Longest time in ms between two changes of a client's [heartbeat](modbus.md#heartbeat-and-lost-clients) on
        /// Modbus.
        pub heartbeat: Duration = "modbus_heartbeat_ms",
            whole(1000, between(100..=60_000, "leave it out for 1000"), Duration::from_millis), Reload;
    }
}

/// Settings of Modbus TCP.
#[derive(Debug, Clone, PartialEq)]
pub struct Modbus {
    pub address: SocketAddr,
    /// Place of the address in the configuration.
    pub place: ConfigPlace,
    pub rules: ModbusRules,
}

impl Modbus {
    /// Merges the flag with the file. `None` if Modbus is off.
    pub(super) fn merge(flags: &Flags, file: &File, may_be_exposed: bool) -> Result<Option<Self>, ConfigError> {
        let ModbusContent { address, rules } = file.content.modbus.clone();
        let Some(Placed { value, place }) = file.pick(flags.modbus.as_ref(), "--modbus", address.as_ref()) else {
            return Ok(None);
        };
        let address = parse_address(&value, "192.168.1.5:502", &place)?;
        if !address.ip().is_loopback() && rules.allow.is_empty() && !may_be_exposed {
            let detail = format!(
                "{address} is not a loopback address, and Modbus has no credentials: any client that reaches it can move \
                 the grippers. List the allowed networks in modbus_allow, name the clients in [[clients]] sections, or pass \
                 --insecure if the network is yours alone"
            );
            return Err(ConfigError::at(&place, detail));
        }
        Ok(Some(Self { address, place, rules }))
    }
}

/// A gripper's unit identifier.
pub(super) fn unit() -> SettingValue<Option<u8>> {
    let range = between(1..=247, "leave it out to number the grippers by their names");
    optional_whole(1, range, |unit| unit as u8).shown("the first free number, in alphabetical order of the names", "1")
}

/// Returns the conflict if two grippers have the same unit identifier.
pub(super) fn conflict(one: &GripperConfig, other: &GripperConfig) -> Option<String> {
    let unit = one.modbus_unit.filter(|unit| Some(*unit) == other.modbus_unit)?;
    Some(format!("{} and {} both have modbus_unit {unit}: give each its own", one.name, other.name))
}

impl Config {
    /// Returns the grippers by their unit identifiers. Grippers without one in the file get the free ones, in the order of
    /// their names.
    #[must_use]
    pub fn modbus_units(&self) -> BTreeMap<u8, Name> {
        let given = self.grippers.iter().filter_map(|gripper| Some((gripper.modbus_unit?, gripper.name.clone())));
        let mut units: BTreeMap<u8, Name> = given.collect();
        let mut others: Vec<_> = self.grippers.iter().filter(|gripper| gripper.modbus_unit.is_none()).collect();
        others.sort_by_key(|gripper| &gripper.name);
        let free: Vec<u8> = UNITS.filter(|unit| !units.contains_key(unit)).collect();
        units.extend(free.into_iter().zip(others.into_iter().map(|gripper| gripper.name.clone())));
        units
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn config(text: &str) -> Result<Config, String> {
        let file = File::parse(Path::new("f.toml"), text.to_owned());
        file.and_then(|file| Config::merge(&Flags::default(), Some(&file))).map_err(|error| error.to_string())
    }

    #[test]
    fn modbus_is_off_by_default() {
        assert_eq!(config("").unwrap().modbus, None);
        let flags = Flags { modbus: Some("127.0.0.1:5020".to_owned()), ..Flags::default() };
        let modbus = Config::load(&flags).unwrap().modbus.unwrap();
        assert_eq!((modbus.address.port(), modbus.rules.heartbeat), (5020, Duration::from_secs(1)));
    }

    #[test]
    fn open_address_needs_a_list_of_clients() {
        let open = config("modbus = \"0.0.0.0:502\"").unwrap_err();
        assert!(open.starts_with("f.toml:1: ") && open.contains("modbus_allow"), "{open}");
        let listed = config("modbus = \"0.0.0.0:502\"\nmodbus_allow = [\"10.0.0.0/24\"]\nmodbus_heartbeat_ms = 250");
        let modbus = listed.unwrap().modbus.unwrap();
        assert_eq!((modbus.rules.allow.len(), modbus.rules.heartbeat), (1, Duration::from_millis(250)));
        for wrong in ["modbus = \"here\"", "modbus = \"127.0.0.1:0\"\nmodbus_heartbeat_ms = 50"] {
            assert!(config(wrong).unwrap_err().contains("modbus") || config(wrong).unwrap_err().contains("here"));
        }
    }

    #[test]
    fn grippers_without_a_unit_get_the_free_ones() {
        let grippers = "[grippers.c]\nurl = \"sim://wsg50\"\n[grippers.a]\nurl = \"sim://wsg50\"\n[grippers.b]\nurl = \
                        \"sim://wsg50\"\nmodbus_unit = 1";
        let units = config(grippers).unwrap().modbus_units();
        let units: Vec<_> = units.iter().map(|(unit, name)| (*unit, name.as_str())).collect();
        assert_eq!(units, [(1, "b"), (2, "a"), (3, "c")]);
        let twice = format!("{grippers}\n[grippers.d]\nurl = \"sim://wsg50\"\nmodbus_unit = 1");
        assert!(config(&twice).unwrap_err().contains("modbus_unit 1"));
        assert!(config("[grippers.a]\nurl = \"sim://wsg50\"\nmodbus_unit = 248").unwrap_err().contains("247"));
    }
}
