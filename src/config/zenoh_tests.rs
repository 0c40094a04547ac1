use std::path::Path;

use super::super::{Config, Flags};
use super::*;

fn flags() -> Flags {
    Flags::default()
}

fn listening(endpoint: &str) -> Flags {
    Flags { zenoh: ZenohFlags { zenoh_listen: vec![endpoint.to_owned()], ..ZenohFlags::default() }, ..flags() }
}

fn load(flags: &Flags) -> Result<Zenoh, String> {
    Config::load(flags).map(|config| config.zenoh.unwrap()).map_err(|error| error.to_string())
}

/// Loads `own` as Zenoh's own file, and `section` in the gateway's file.
fn of_files(name: &str, own: &str, section: &str, flags: &Flags) -> Result<Zenoh, String> {
    let directory = std::env::temp_dir().join(format!("wsg-gateway-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&directory).unwrap();
    let path = directory.join("zenoh.json5");
    std::fs::write(&path, own).unwrap();
    let text = format!("[zenoh]\nconfig = {:?}\n{section}", path.display().to_string());
    let file = File::parse(Path::new("gateway.toml"), text).map_err(|error| error.to_string());
    let config = file.and_then(|file| Config::merge(flags, Some(&file)).map_err(|error| error.to_string()));
    std::fs::remove_dir_all(directory).unwrap();
    config.map(|config| config.zenoh.unwrap())
}

#[test]
fn default_is_a_peer_on_loopback_without_scouting() {
    let zenoh = load(&flags()).unwrap();
    assert_eq!((zenoh.listen.as_slice(), zenoh.connect.len(), zenoh.max_hz), (&[DEFAULT_LISTEN.to_owned()][..], 0, 50));
    assert_eq!(zenoh.setting("mode"), "peer");
    assert_eq!(zenoh.setting("listen/endpoints"), json!([DEFAULT_LISTEN]));
    assert_eq!(zenoh.looks_for(), None);
    // Zenoh reports more members of these than were set.
    let longer = ["scouting/gossip/autoconnect", "listen/retry", "connect/retry", "qos/network"];
    for (key, value) in defaults().into_iter().filter(|(key, _)| !longer.contains(key)) {
        assert_eq!(zenoh.setting(key), value, "{key}");
    }
    assert_eq!(zenoh.setting("qos/network")[0]["overwrite"]["priority"], "real_time");
}

#[test]
fn zenoh_can_be_off_and_client_needs_an_endpoint() {
    let mode = |mode| Flags { zenoh: ZenohFlags { zenoh_mode: Some(mode), ..ZenohFlags::default() }, ..flags() };
    assert_eq!(Config::load(&mode(ZenohMode::Off)).unwrap().zenoh, None);
    assert!(load(&mode(ZenohMode::Client)).unwrap_err().contains("--zenoh-connect"));
    let connected = ZenohFlags { zenoh_connect: vec!["tcp/127.0.0.1:7448".to_owned()], ..ZenohFlags::default() };
    assert_eq!(load(&Flags { zenoh: connected, ..flags() }).unwrap().setting("mode"), "router");
    let mut client = mode(ZenohMode::Client);
    client.zenoh.zenoh_connect = vec!["tcp/127.0.0.1:7447".to_owned()];
    assert_eq!(load(&client).unwrap().listen.len(), 0);
}

#[test]
fn non_loopback_endpoint_needs_credentials_or_insecure() {
    let inside = ["tcp/127.0.0.1:7447", "tcp/[::1]:0", "tcp/localhost:7447", "tls/127.1.2.3:7447", "quic/[::1]:7447"];
    for endpoint in inside {
        assert!(load(&listening(endpoint)).is_ok(), "{endpoint}");
    }
    for endpoint in ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.5:7447", "quic/cell-7.example:7447"] {
        let error = load(&listening(endpoint)).unwrap_err();
        assert!(error.starts_with("--zenoh-listen: ") && error.contains("--insecure"), "{error}");
        assert!(load(&Flags { insecure: true, ..listening(endpoint) }).is_ok());
    }
    for endpoint in ["", "7447", "127.0.0.1:7447", "udp/127.0.0.1:7447"] {
        assert!(load(&listening(endpoint)).unwrap_err().contains("not a Zenoh endpoint"), "{endpoint}");
    }
}

#[test]
fn zenoh_file_overrides_only_what_it_sets() {
    let file = "{mode: 'router', listen: {endpoints: {router: ['tcp/127.0.0.1:7450']}}, transport: {link: {tx: {lease: 5000}}}}";
    let zenoh = of_files("counts", file, "max_hz = 20\nconnect = ['tcp/127.0.0.1:7451']", &flags()).unwrap();
    assert_eq!(
        (zenoh.listen[0].as_str(), zenoh.connect[0].as_str(), zenoh.max_hz),
        ("tcp/127.0.0.1:7450", "tcp/127.0.0.1:7451", 20)
    );
    assert_eq!((zenoh.setting("mode"), zenoh.setting("transport/link/tx/lease")), (json!("router"), json!(5000)));
    assert_eq!(zenoh.setting("transport/link/rx/max_message_size"), MAX_MESSAGE_BYTES);
    assert_eq!(zenoh.looks_for(), None);
    let flag = of_files("flag", file, "", &listening("tcp/127.0.0.1:0")).unwrap();
    assert_eq!(flag.listen, ["tcp/127.0.0.1:0"]);
    assert_eq!(of_files("nothing", "{}", "", &flags()).unwrap().listen, [DEFAULT_LISTEN]);
}

#[test]
fn zenoh_file_path_is_relative_to_gateway_file() {
    let directory = std::env::temp_dir().join(format!("wsg-gateway-{}-beside", std::process::id()));
    std::fs::create_dir_all(directory.join("network")).unwrap();
    std::fs::write(directory.join("network/own.json5"), "{mode: 'router'}").unwrap();
    let path = directory.join("gateway.toml");
    std::fs::write(&path, "[zenoh]\nconfig = 'network/own.json5'").unwrap();
    let zenoh = load(&Flags { config: Some(path), ..flags() });
    std::fs::remove_dir_all(directory).unwrap();
    assert_eq!(zenoh.unwrap().setting("mode"), "router");
}

#[test]
fn access_control_must_deny_by_default() {
    let file = |permission: &str| {
        format!(
            "{{listen: {{endpoints: ['tcp/0.0.0.0:7447']}}, access_control: {{enabled: true, \
             default_permission: '{permission}', rules: [], subjects: [], policies: []}}}}"
        )
    };
    let error = of_files("allows", &file("allow"), "", &flags()).unwrap_err();
    assert!(error.contains("access_control that denies by default"), "{error}");
    of_files("denies", &file("deny"), "", &flags()).unwrap();
    let off = file("deny").replace("enabled: true", "enabled: false");
    assert!(of_files("off", &off, "", &flags()).is_err());
    let shipped = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/zenoh/gateway.json5")).unwrap();
    let shipped = of_files("shipped", &shipped, "", &flags()).unwrap();
    assert_eq!(shipped.setting("access_control/default_permission"), "deny");
    assert!(shipped.asks_for_credentials());
}

#[test]
fn zenoh_file_beyond_loopback_needs_credentials() {
    let refused = |name, file| of_files(name, file, "", &flags()).unwrap_err();
    let error = refused("open", "{listen: {endpoints: ['tcp/0.0.0.0:7447']}}");
    assert!(error.starts_with("gateway.toml:2: tcp/0.0.0.0:7447 reaches beyond loopback"), "{error}");
    assert!(refused("scouts", "{scouting: {multicast: {enabled: true}}}").contains("scouting/multicast/enabled"));
    assert!(refused("gossips", "{scouting: {gossip: {autoconnect: {peer: ['peer']}}}}").contains("gossip"));
    assert!(refused("no", "{mode: 'leader'}").starts_with("gateway.toml:2: "));
    for file in [
        "{listen: {endpoints: ['tcp/0.0.0.0:7447']}, access_control: {enabled: true, default_permission: 'deny', rules: [], subjects: [], policies: []}}",
        "{listen: {endpoints: ['tls/0.0.0.0:7447']}, transport: {link: {tls: {enable_mtls: true}}}}",
        "{listen: {endpoints: ['quic/0.0.0.0:7447']}, transport: {link: {tls: {enable_mtls: true}}}}",
    ] {
        of_files("credentials", file, "", &flags()).unwrap();
    }
    assert!(refused("one-way", "{listen: {endpoints: ['quic/0.0.0.0:7447']}}").contains("quic/0.0.0.0:7447"));
    let own =
        "{listen: {endpoints: ['quic/0.0.0.0:7447#enable_mtls=false']}, transport: {link: {tls: {enable_mtls: true}}}}";
    assert!(refused("own", own).contains("enable_mtls=false"));
    let only_tls = "{listen: {endpoints: ['tcp/0.0.0.0:7447']}, transport: {link: {tls: {enable_mtls: true}}}}";
    assert!(refused("mixed", only_tls).contains("tcp/0.0.0.0:7447"));
}

#[test]
fn only_tls_endpoints_are_warned_about() {
    let listen = ["tcp/127.0.0.1:1", "tls/127.0.0.1:2", "quic/127.0.0.1:3"].map(str::to_owned).to_vec();
    let zenoh_connect = vec!["tls/127.0.0.1:4".to_owned()];
    let zenoh = ZenohFlags { zenoh_listen: listen, zenoh_connect, ..ZenohFlags::default() };
    assert_eq!(load(&Flags { zenoh, ..flags() }).unwrap().tls_endpoints(), ["tls/127.0.0.1:2", "tls/127.0.0.1:4"]);
}

#[test]
fn section_error_names_its_line() {
    let error = |text: &str| {
        let file = File::parse(Path::new("gateway.toml"), text.to_owned());
        file.and_then(|file| Config::merge(&flags(), Some(&file))).unwrap_err().to_string()
    };
    assert!(error("[zenoh]\nmax_hz = 0").starts_with("gateway.toml:2: max_hz is 0; it must be from 1 to 100"));
    for endpoint in ["nowhere", "tcp/10.0.0.7:7447 ", "tcp/10.0\u{2029}.0.7:7447"] {
        let error = error(&format!("[zenoh]\nlisten = ['{endpoint}']"));
        assert!(error.starts_with(&format!("gateway.toml:2: {endpoint:?} is not a Zenoh endpoint")), "{error}");
    }
    for host in ["192.168.001.020", "127.1", "2130706440"] {
        for endpoint in [format!("tcp/{host}:7447"), format!("quic/{host}:7447#enable_mtls=false")] {
            let error = error(&format!("[zenoh]\nconnect = ['{endpoint}']"));
            assert!(error.starts_with("gateway.toml:2: ") && error.contains("not a plain IPv4 address"), "{error}");
        }
    }
    let with_path = listening("tls/127.0.0.1:7447#root_ca_certificate_file=/etc/wsg gateway/ca.pem");
    assert_eq!(load(&with_path).unwrap().listen, with_path.zenoh.zenoh_listen);
    assert!(error("[zenoh]\nconfig = 'none.json5'").contains("none.json5"));
    assert!(error("[zenoh]\nmode = 'leader'").starts_with("gateway.toml:2: "));
}
