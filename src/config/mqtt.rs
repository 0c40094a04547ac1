//! MQTT in the configuration file.

use std::net::IpAddr;
use std::path::PathBuf;

use toml::Spanned;

use super::webhooks::from_file;
use super::{ConfigError, File, GripperConfig, blank};
use crate::interfaces::mqtt::{
    Broker, BrokerCertificate, BrokerLogin, BrokerTls, BrokerUrl, InvalidPrefix, MqttRules, MqttSettings, Topics,
};
use crate::model::Name;
use crate::settings::{optional, required, settings};
use crate::webhooks::Authorities;

/// Longest client identifier, in bytes, without the purpose that some connections append.
const MAX_CLIENT_ID_BYTES: usize = 64;

/// Levels of topics that are no names of grippers.
const RESERVED: [&str; 2] = ["command", "response"];

settings! {
    pub(super) struct MqttContent {
        /// Address of the broker, which must speak MQTT 5. `mqtts://` is encrypted.
        broker: Spanned<String> = "broker",
            required(blank(), "`mqtt://HOST:PORT`, `mqtts://HOST:PORT`", "\"mqtts://broker.example:8883\""), Reload;
        /// Beginning of all topics. Each gateway needs its own.
        prefix: Option<Spanned<String>> = "prefix", optional("levels of a topic", "")
            .shown("`wsg/` and the gateway's name", "\"enterprise/site/area/line/cell\""), Reload;
        /// Client identifier at the broker. Connections that receive append `-commands` or `-fast-stop`.
        client_id: Option<Spanned<String>> = "client_id",
            optional("1 to 64 letters, digits, `-`, `_`, `.`", "").shown("`wsg-` and the gateway's name", "\"wsg-cell-7\""),
            Reload;
        /// User name at the broker. Needs `password_file`.
        user: Option<Spanned<String>> = "user", optional("a name", "\"cell-7\""), Reload;
        /// File that contains the password. A relative path starts at the directory of the configuration file.
        pub(super) password_file: Option<Spanned<PathBuf>> = "password_file",
            optional("a path", "\"broker.password\""), Reload;
        /// Certificates of the authorities that the broker's certificate can come from, in PEM form.
        pub(super) ca_file: Option<Spanned<PathBuf>> = "ca_file",
            optional("a path", "").shown("public authorities", "\"plant-ca.pem\""), Reload;
        /// The gateway's own certificate for the broker, in PEM form. Needs `key_file`.
        pub(super) certificate_file: Option<Spanned<PathBuf>> = "certificate_file",
            optional("a path", "\"gateway.pem\""), Reload;
        /// Private key of this certificate, in PEM form.
        pub(super) key_file: Option<Spanned<PathBuf>> = "key_file", optional("a path", "\"gateway-key.pem\""), Reload;
        group rules: MqttRules;
    }
}

/// Validates the section. Returns `None` if MQTT is off.
pub(super) fn settings(
    file: &File,
    name: &Name,
    grippers: &[GripperConfig],
) -> Result<Option<MqttSettings>, ConfigError> {
    let Some(content) = &file.content.mqtt else { return Ok(None) };
    let url: BrokerUrl = parsed(file, &content.broker)?;
    let topics: Topics = match &content.prefix {
        Some(prefix) => parsed(file, prefix)?,
        // A name is a valid level of a topic.
        None => {
            default_topics(name).map_err(|error| ConfigError::at(&file.place(content.broker.span().start), error))?
        }
    };
    if let Some(gripper) = grippers.iter().find(|gripper| RESERVED.contains(&gripper.name.as_str())) {
        let detail = format!("MQTT has topics of its own named {}: give the gripper another name", gripper.name);
        return Err(ConfigError::at(&gripper.place, detail));
    }
    let tls = tls(file, content, &url)?;
    Ok(Some(MqttSettings {
        broker: Broker { host: url.host, port: url.port, tls },
        client_id: client_id(file, content, name)?,
        topics,
        login: login(file, content)?,
        rules: content.rules.clone(),
    }))
}

fn default_topics(name: &Name) -> Result<Topics, InvalidPrefix> {
    format!("wsg/{name}").parse()
}

fn parsed<T: std::str::FromStr<Err: std::fmt::Display>>(file: &File, text: &Spanned<String>) -> Result<T, ConfigError> {
    text.get_ref().parse().map_err(|error| ConfigError::at(&file.place(text.span().start), error))
}

fn client_id(file: &File, content: &MqttContent, name: &Name) -> Result<String, ConfigError> {
    let Some(given) = &content.client_id else { return Ok(format!("wsg-{name}")) };
    let id = given.get_ref();
    let is_valid = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
    if id.is_empty() || id.len() > MAX_CLIENT_ID_BYTES || !id.bytes().all(is_valid) {
        let detail = "client_id must have 1 to 64 letters, digits, `-`, `_` or `.`";
        return Err(ConfigError::at(&file.place(given.span().start), detail));
    }
    Ok(id.clone())
}

fn login(file: &File, content: &MqttContent) -> Result<Option<BrokerLogin>, ConfigError> {
    match (&content.user, &content.password_file) {
        (None, None) => Ok(None),
        (Some(user), Some(path)) => {
            let password = from_file(file, path, |bytes| String::from_utf8(bytes.to_vec()))?;
            // Editors end a file with a line break.
            let password = password.trim_end_matches(['\r', '\n']).to_owned();
            Ok(Some(BrokerLogin::new(user.get_ref().clone(), password)))
        }
        (Some(given), None) => {
            Err(ConfigError::at(&file.place(given.span().start), "user needs a password_file: add it"))
        }
        (None, Some(given)) => {
            Err(ConfigError::at(&file.place(given.span().start), "password_file needs a user: add it"))
        }
    }
}

fn tls(file: &File, content: &MqttContent, url: &BrokerUrl) -> Result<Option<BrokerTls>, ConfigError> {
    let MqttContent { ca_file, certificate_file, key_file, .. } = content;
    if !url.is_encrypted {
        let given = [ca_file, certificate_file, key_file].into_iter().flatten().next();
        return given.map_or(Ok(None), |given| {
            let detail =
                "ca_file, certificate_file and key_file need an encrypted connection: write mqtts:// in broker";
            Err(ConfigError::at(&file.place(given.span().start), detail))
        });
    }
    let authorities = ca_file.as_ref().map(|path| from_file(file, path, Authorities::from_pem)).transpose()?;
    let certificate = match (certificate_file, key_file) {
        (None, None) => None,
        (Some(certificate), Some(key)) => {
            Some(BrokerCertificate { certificate: bytes(file, certificate)?, key: bytes(file, key)? })
        }
        (Some(given), None) | (None, Some(given)) => {
            let detail = "certificate_file and key_file belong together: add the other one";
            return Err(ConfigError::at(&file.place(given.span().start), detail));
        }
    };
    let tls = BrokerTls::new(&url.host, authorities.unwrap_or_default(), certificate);
    let place = certificate_file.as_ref().map_or_else(|| content.broker.span().start, |path| path.span().start);
    tls.map(Some).map_err(|error| ConfigError::at(&file.place(place), error))
}

fn bytes(file: &File, path: &Spanned<PathBuf>) -> Result<Vec<u8>, ConfigError> {
    from_file(file, path, |bytes| Ok::<_, std::convert::Infallible>(bytes.to_vec()))
}

/// Returns the warning that others on the network can read and change messages, if so.
pub(super) fn exposure(file: &File, settings: Option<&MqttSettings>) -> Option<ConfigError> {
    let MqttSettings { broker, rules, .. } = settings?;
    let address: Option<IpAddr> = broker.host.parse().ok();
    let is_local = broker.host == "localhost" || address.is_some_and(|address| address.is_loopback());
    if broker.tls.is_some() || is_local || !(rules.commands || rules.fast_stop) {
        return None;
    }
    let content = file.content.mqtt.as_ref()?;
    let detail = "MQTT is not encrypted (mqtt://), so anyone on the network can send commands as the broker: write \
                  mqtts://";
    Some(ConfigError::at(&file.place(content.broker.span().start), detail))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::{Config, Flags};
    use super::*;
    use crate::access::Role;

    const SECTION: &str = "[mqtt]\nbroker = \"mqtt://127.0.0.1\"\nprefix = \"plant/cell\"\n";

    fn config(text: &str) -> Result<Config, String> {
        let file = File::parse(Path::new("gateway.toml"), text.to_owned());
        file.and_then(|file| Config::merge(&Flags::default(), Some(&file))).map_err(|error| error.to_string())
    }

    #[test]
    fn mqtt_only_publishes_by_default() {
        assert_eq!(config("").unwrap().mqtt, None);
        let mqtt = config(SECTION).unwrap().mqtt.unwrap();
        assert_eq!((mqtt.client_id.as_str(), mqtt.broker.port), ("wsg-gateway", 1883));
        assert!(!mqtt.rules.commands && !mqtt.rules.fast_stop && mqtt.rules.events && mqtt.rules.grips);
        let without_prefix = config("[mqtt]\nbroker = \"mqtt://127.0.0.1\"\n").unwrap().mqtt.unwrap();
        assert_eq!(without_prefix.topics.to_string(), "wsg/gateway");
        assert_eq!((mqtt.rules.role, mqtt.rules.telemetry_interval), (Role::Operator, None));
    }

    #[test]
    fn wrong_section_is_named_without_its_secret() {
        let directory = std::env::temp_dir().join(format!("wsg-mqtt-{}", std::process::id()));
        std::fs::create_dir_all(&directory).unwrap();
        let password = directory.join("password");
        std::fs::write(&password, "s3cret\n").unwrap();
        let with = |lines: &str| format!("{SECTION}{lines}\n");
        let encrypted = |lines: &str| with(lines).replace("mqtt://", "mqtts://");
        for (text, expected) in [
            ("[mqtt]\nprefix = \"a\"\n".to_owned(), "missing field `broker`"),
            (SECTION.replace("plant/cell", "plant/#"), "gateway.toml:3: the prefix contains"),
            (SECTION.replace("mqtt://", "tcp://"), "gateway.toml:2: the broker is neither"),
            (with("client_id = \"a b\""), "gateway.toml:4: client_id must have"),
            (with("user = \"anna\""), "gateway.toml:4: user needs a password_file"),
            (with(&format!("password_file = {password:?}")), "gateway.toml:4: password_file needs a user"),
            (with("ca_file = \"ca.pem\""), "gateway.toml:4: ca_file, certificate_file and key_file need"),
            (encrypted("key_file = \"key.pem\""), "gateway.toml:4: certificate_file and key_file belong"),
            (encrypted(&format!("ca_file = {password:?}")), "no certificate in PEM form"),
            (with("telemetry_interval_ms = 5"), "gateway.toml:4: telemetry_interval_ms is 5; it must be from 20"),
            (with("[grippers.command]\nurl = \"sim://wsg50\""), "MQTT has topics of its own named command"),
        ] {
            let error = config(&text).unwrap_err();
            assert!(error.contains(expected) && !error.contains("s3cret"), "{text}: {error}");
        }
        let lines = format!("user = \"anna\"\npassword_file = {password:?}");
        let login = config(&with(&lines)).unwrap().mqtt.unwrap().login;
        assert_eq!(login, Some(BrokerLogin::new("anna".to_owned(), "s3cret".to_owned())));
        std::fs::remove_dir_all(directory).unwrap();
    }

    #[test]
    fn commands_without_encryption_are_warned_of() {
        let warned =
            |text: &str| config(text).unwrap().warnings.iter().any(|warning| warning.to_string().contains("mqtts://"));
        let remote = SECTION.replace("127.0.0.1", "10.0.0.5");
        assert!(warned(&format!("{remote}commands = true\n")) && warned(&format!("{remote}fast_stop = true\n")));
        assert!(!warned(&remote) && !warned(&format!("{SECTION}commands = true\n")));
        assert!(!warned(&format!("{}commands = true\n", remote.replace("mqtt://", "mqtts://"))));
    }
}
