use std::path::Path;
use std::time::Duration;

use super::super::Config;
use super::*;

fn parsed(flags: &Flags, text: &str) -> Result<Config, ConfigError> {
    let file = File::parse(Path::new("/etc/wsg/gateway.toml"), text.to_owned())?;
    Config::merge(flags, Some(&file))
}

fn guarded(text: &str) -> Guarded {
    match parsed(&Flags::default(), text).unwrap().access {
        AccessConfig::Guarded(guarded) => guarded,
        AccessConfig::Open => panic!("clients need no credentials"),
    }
}

#[test]
fn credentials_are_needed_where_they_are_mentioned() {
    assert_eq!(parsed(&Flags::default(), "").unwrap().access, AccessConfig::Open);
    let access = guarded("[access]");
    assert_eq!((access.tokens, access.fast_stop), ("/etc/wsg/tokens.json".into(), FastStopPolicy::Anyone));
    let flags = Flags { tokens: Some("t.json".into()), ..Flags::default() };
    assert!(matches!(parsed(&flags, "").unwrap().access, AccessConfig::Guarded(_)));
    let plc = "[[clients]]\nname = \"plc\"\naddress = \"192.168.1.10\"\nrole = \"operator\"\ngrippers = [\"left\"]";
    let [plc] = guarded(plc).clients.try_into().unwrap();
    assert_eq!((plc.matched_by, plc.role), (ClientMatch::Address("192.168.1.10/32".parse().unwrap()), Role::Operator));
    assert_eq!(plc.scope, Scope::Only(["left".parse().unwrap()].into()));
}

#[test]
fn mapped_address_is_that_of_its_clients() {
    for (text, expected) in [
        ("::ffff:127.0.0.9", "127.0.0.9/32"),
        ("::ffff:10.0.0.0/120", "10.0.0.0/24"),
        ("::ffff:0:0/96", "0.0.0.0/0"),
        ("::1", "::1/128"),
    ] {
        let [client] = guarded(&format!("[[clients]]\nname = \"c\"\naddress = \"{text}\"\nrole = \"stop\""))
            .clients
            .try_into()
            .unwrap();
        assert_eq!(client.matched_by, ClientMatch::Address(expected.parse().unwrap()));
    }
}

#[test]
fn every_key_is_read() {
    let access = guarded(
        "[access]\ntokens = \"/run/tokens\"\nfast_stop = \"credential\"\nzenoh_role = \"operator\"\nsession_idle_h = 1\npin_idle_min = 2",
    );
    assert_eq!((access.tokens, access.fast_stop), ("/run/tokens".into(), FastStopPolicy::Credential));
    let times = SessionTimes { idle: Duration::from_hours(1), pin_idle: Duration::from_mins(2) };
    assert_eq!((access.zenoh_role, access.times), (Some(Role::Operator), times));
}

#[test]
fn wrong_value_is_named_with_its_line() {
    for (text, expected) in [
        ("[access]\nsession_idle_h = 0", "gateway.toml:2: session_idle_h is 0"),
        (
            "[[clients]]\nname = \"plc\"\naddress = \"plc\"\nrole = \"operator\"",
            "gateway.toml:3: \"plc\" is neither an addr",
        ),
        (
            "[[clients]]\nname = \"plc\"\naddress = \"192.168.1.10/24\"\nrole = \"stop\"",
            "gateway.toml:3: \"192.168.1.10/24\" is an address with the prefix of a network: write 192.168.1.10 or \
             192.168.1.0/24",
        ),
        ("[[clients]]\nname = \"plc\"\naddress = \"::1\"\nrole = \"boss\"", "gateway.toml:4: unknown variant `boss`"),
        ("[access]\npin_idle_min = 500", "gateway.toml:2: pin_idle_min is 500"),
        (
            "[[clients]]\nname = \"plc\"\nrole = \"stop\"",
            "gateway.toml:2: a client is known by its address or by its certificate",
        ),
        (
            "[[clients]]\nname = \"plc\"\ncertificate = \"plc\"\nrole = \"stop\"",
            "gateway.toml:2: a client's certificate",
        ),
        ("[[clients]]\nname = \"a b\"\naddress = \"::1\"\nrole = \"stop\"", "gateway.toml:2: "),
    ] {
        let error = parsed(&Flags::default(), text).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn other_addresses_need_credentials_and_tls() {
    let open = |text: &str| parsed(&Flags { listen: Some("0.0.0.0:8080".to_owned()), ..Flags::default() }, text);
    let tls = "[tls]\ncertificate = \"c.pem\"\nkey = \"k.pem\"\n";
    assert!(open("").unwrap_err().to_string().contains("wsg-gateway init --listen 0.0.0.0:8080 DIR"));
    assert!(open(tls).unwrap_err().to_string().contains("clients need no credentials"));
    assert!(open("[access]").unwrap_err().to_string().contains("insecure_http = true"));
    let config = open(&format!("{tls}[access]")).unwrap();
    assert_eq!(config.tls.unwrap().key, Path::new("/etc/wsg/k.pem"));
    let AccessConfig::Guarded(guarded) = config.access else { panic!("clients need no credentials") };
    assert_eq!(guarded.fast_stop, FastStopPolicy::Credential);
    assert!(open("insecure_http = true\n[access]").is_ok());
}
