use std::path::Path;
use std::time::Duration;

use super::*;
use crate::interfaces::wsg_port::{AcknowledgePolicy, Datagrams, ListenAddress};
use crate::model::{OnJournalFailure, UpdateMode, UpdateRules};

fn flags() -> Flags {
    Flags::default()
}

fn file(text: &str) -> Result<Config, ConfigError> {
    Config::merge(&flags(), Some(&File::parse(Path::new("gateway.toml"), text.to_owned())?))
}

#[test]
fn defaults_are_two_simulated_grippers_on_loopback() {
    let config = Config::load(&flags()).unwrap();
    let names: Vec<_> = config.grippers.iter().map(|gripper| gripper.name.as_str()).collect();
    assert_eq!(names, ["left", "right"]);
    assert_eq!(config.listen.to_string(), "127.0.0.1:8080");
}

#[test]
fn flag_overrides_file() {
    let text = "name = \"cell-7\"\nlisten = \"127.0.0.1:9000\"\n[grippers.g]\nurl = \"tcp://10.0.0.1:1000\"\n";
    let config = file(text).unwrap();
    assert_eq!((config.name.as_str(), config.listen.port()), ("cell-7", 9000));
    assert_eq!(config.grippers[0].device, DeviceSource::At("tcp://10.0.0.1:1000".parse().unwrap()));

    let parsed = File::parse(Path::new("gateway.toml"), text.to_owned()).unwrap();
    let flags = Flags { listen: Some("127.0.0.1:9001".to_owned()), ..flags() };
    assert_eq!(Config::merge(&flags, Some(&parsed)).unwrap().listen.port(), 9001);
}

#[test]
fn motion_pause_is_50_ms_unless_set() {
    let pause = |key: &str| {
        let config = file(&format!("[grippers.g]\nurl = \"sim://wsg50\"\n{key}"));
        config.map(|config| config.grippers[0].rules.motion_pause).map_err(|error| error.to_string())
    };
    assert_eq!(pause(""), Ok(Duration::from_millis(50)));
    assert_eq!(pause("motion_pause_ms = 0"), Ok(Duration::ZERO));
    assert!(pause("motion_pause_ms = 1001").unwrap_err().contains("gateway.toml:3: motion_pause_ms is 1001"));
}

#[test]
fn drift_limits_have_defaults_and_bounds() {
    let drift = |keys: &str| {
        let config = file(&format!("[drift]\n{keys}"));
        config.map(|config| config.drift).map_err(|error| error.to_string())
    };
    assert_eq!(Config::load(&flags()).unwrap().drift, Some(DriftLimits::default()));
    assert_eq!(drift(""), Ok(Some(DriftLimits::default())));
    assert_eq!(drift("sigmas = 4\nmin_mm = 0.2"), Ok(Some(DriftLimits { sigmas: 4.0, min_mm: 0.2 })));
    assert_eq!(drift("warnings = false"), Ok(None));
    assert!(drift("sigmas = 0.5").unwrap_err().contains("gateway.toml:2: sigmas is 0.5; it must be from 1 to 100"));
    assert!(drift("min_mm = nan").unwrap_err().contains("min_mm is NaN"));
}

#[test]
fn public_url_is_a_web_page_without_secrets() {
    let url = |value: &str| {
        file(&format!("public_url = \"{value}\""))
            .map(|config| config.web.public_url.map(|url| url.to_string()))
            .map_err(|error| error.to_string())
    };
    assert_eq!(url("https://cell-7.example:8080"), Ok(Some("https://cell-7.example:8080/".to_owned())));
    let long = format!("https://cell-7.example/{}", "x".repeat(512));
    for wrong in
        ["cell-7", "javascript:alert(1)", "https://:secret@cell-7.example", "https://cell-7/?a=b", "http://*/", &long]
    {
        let error = url(wrong).unwrap_err();
        assert!(error.contains("public_url") && !error.contains("secret"), "{error}");
    }
}

#[test]
fn frame_ancestors_are_origins() {
    let origins = |value: &str| {
        file(&format!("frame_ancestors = [{value}]"))
            .map(|config| config.web.frame_ancestors)
            .map_err(|error| error.to_string())
    };
    assert_eq!(origins("\"https://hmi.example\""), Ok(vec!["https://hmi.example".to_owned()]));
    for wrong in ["*", "hmi.example", "https://hmi.example/path", "https://hmi.example; script-src *", "file:///"] {
        let error = origins(&format!("\"{wrong}\"")).unwrap_err();
        assert!(error.starts_with("gateway.toml:1: frame_ancestors has"), "{error}");
    }
}

#[test]
fn file_error_names_line_and_remedy() {
    let mistake = |text: &str| file(text).unwrap_err().to_string();
    assert!(mistake("name = \"Cell 7\"").starts_with("gateway.toml:1: \"Cell 7\" is not a valid name"));
    assert!(mistake("\n\nlisten = \"8080\"").starts_with("gateway.toml:3: \"8080\" is not an address"));
    assert!(
        mistake("[grippers.g]\n\nurl = \"can://can0?tx=9999\"").starts_with("gateway.toml:3: \"can://can0?tx=9999\": ")
    );
    assert!(mistake("name = \"a\"\nlistne = 1").starts_with("gateway.toml:2: unknown field `listne`"));
    assert!(
        mistake("[grippers.Left]\nurl = \"sim://wsg50\"").starts_with("gateway.toml:1: \"Left\" is not a valid name")
    );
    assert!(mistake("journal = \"\"").starts_with("gateway.toml:1: the journal's path is empty"));
    assert!(
        mistake("\njournal_max_size_mb = 20000000")
            .starts_with("gateway.toml:2: journal_max_size_mb is 20000000; it must be from 0 to 16000000: 0 means")
    );
    assert!(mistake("journal_max_age_days = 40000").contains("from 1 to 36525"));
    assert!(mistake("on_journal_failure = \"stop\"").contains("expected `refuse` or `continue`"));
    assert!(mistake("[grippers.g]\nurl = \"sim://wsg50\"\nread_ids = [256]").starts_with("gateway.toml:3: "));
    assert!(
        mistake("[grippers.g]\nurl = \"sim://wsg50\"\nread_ids = [176]\nstream_ids = [177, 176]")
            .starts_with("gateway.toml:4: 176 is in read_ids and stream_ids")
    );
    for field in ["stream_max_step_mm", "stream_max_speed_mm_s"] {
        let unreadable = mistake(&format!("[grippers.g]\nurl = \"sim://wsg50\"\n{field} = 5"));
        let expected = format!("gateway.toml:3: {field} needs the places of width and speed");
        assert!(unreadable.starts_with(&expected), "{unreadable}");
    }
    for field in ["read_ids", "stream_ids"] {
        let known = mistake(&format!("[grippers.g]\nurl = \"sim://wsg50\"\n{field} = [176, 33]"));
        let expected =
            format!("gateway.toml:3: {field} contains 33 (21h), which is PrePosition in the manual: list only");
        assert!(known.starts_with(&expected), "{known}");
    }
    assert!(mistake("[grippers.g]\n").contains("missing field `url`"));
    assert!(mistake("\ndrain_ms = 60001").starts_with("gateway.toml:2: drain_ms is 60001; at most 60000 is allowed"));
}

#[test]
fn unreadable_file_is_named_without_a_line() {
    let said = |path: &Path| File::read(path).unwrap_err().to_string();
    assert_eq!(said(Path::new("no-such-file.toml")), "no-such-file.toml: does not exist: check the path");
    let directory = std::env::temp_dir();
    let error = said(&directory);
    assert!(error.starts_with(&format!("{}: ", directory.display())) && error.contains("text file"), "{error}");
}

#[test]
fn flag_error_names_remedy() {
    let mistake = |flags: Flags| Config::load(&flags).unwrap_err().to_string();
    let gripper = |text: &str| Flags { grippers: vec![text.to_owned()], ..flags() };
    assert!(mistake(gripper("left")).contains("left=tcp://192.168.1.20:1000"));
    assert!(mistake(gripper("Left=sim://wsg50")).contains("is not a valid name"));
    assert!(mistake(gripper("left=serial:///dev/ttyUSB0?baud=1")).contains("baud=1 must be one of 1200"));
    let twice = Flags { grippers: vec!["a=sim://wsg50".to_owned(); 2], ..flags() };
    assert!(mistake(twice).contains("two grippers"));
    let shared = vec!["a=tcp://10.0.0.1".to_owned(), "b=tcp://10.0.0.1:1000".to_owned()];
    assert!(mistake(Flags { grippers: shared, ..flags() }).contains("both are at tcp://10.0.0.1:1000"));
    assert!(mistake(Flags { config: Some("/nonexistent.toml".into()), ..flags() }).contains("/nonexistent.toml"));
}

#[test]
fn conflicting_grippers_are_named_with_line_and_remedy() {
    let text = "[grippers.a]\nurl = \"udp://10.0.0.5\"\n[grippers.b]\nurl = \"udp://10.0.0.6?local_port=1501\"\n";
    let mistake = file(text).unwrap_err().to_string();
    assert!(mistake.starts_with("gateway.toml:4: a and b cannot both be served: "), "{mistake}");
    assert!(mistake.contains("UDP port 1501") && mistake.contains("a separate local_port"), "{mistake}");
    assert!(file(&text.replace("=1501", "=1502")).is_ok());
    assert!(file(&text.replace("udp://10.0.0.5", "sim://wsg50")).is_ok());
}

#[test]
fn non_loopback_address_needs_insecure() {
    let open = Flags { listen: Some("0.0.0.0:8080".to_owned()), ..flags() };
    assert!(Config::load(&open).unwrap_err().to_string().contains("--insecure"));
    assert!(Config::load(&Flags { insecure: true, ..open }).is_ok());
    let loopback = Flags { listen: Some("[::1]:8080".to_owned()), ..flags() };
    assert!(Config::load(&loopback).is_ok());
}

#[test]
fn journal_settings_are_applied() {
    let text =
        "journal = \"a.db\"\non_journal_failure = \"continue\"\njournal_max_age_days = 90\njournal_max_size_mb = 500";
    let parsed = File::parse(Path::new("gateway.toml"), text.to_owned()).unwrap();
    let Config { journal, grippers, .. } = Config::merge(&flags(), Some(&parsed)).unwrap();
    assert_eq!(journal.place, JournalLocation::File("a.db".into()));
    assert!(grippers.iter().all(|gripper| gripper.rules.shared.on_journal_failure == OnJournalFailure::Continue));
    assert_eq!(journal.max_age, Some(Duration::from_hours(90 * 24)));
    assert_eq!(journal.max_bytes, Some(500_000_000));
    let flags = Flags { journal: Some(":memory:".to_owned()), ..flags() };
    assert_eq!(Config::merge(&flags, Some(&parsed)).unwrap().journal.place, JournalLocation::Memory);
    let Config { journal, grippers, .. } = Config::load(&flags).unwrap();
    assert!(grippers.iter().all(|gripper| gripper.rules.shared.on_journal_failure == OnJournalFailure::Refuse));
    assert_eq!((journal.max_age, journal.max_bytes), (None, None));
    let on_disk = Flags { journal: Some("a.db".to_owned()), ..flags };
    assert_eq!(Config::load(&on_disk).unwrap().journal.max_bytes, Some(4_096_000_000));
    let endless = File::parse(Path::new("gateway.toml"), "journal_max_size_mb = 0".to_owned()).unwrap();
    assert_eq!(Config::merge(&on_disk, Some(&endless)).unwrap().journal.max_bytes, None);
}

#[test]
fn wsg_port_flag_overrides_file() {
    let text = "[grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = [\"127.0.0.1:1000\", \
                \"udp://127.0.0.1?reply_port=1501&lost_after_ms=10000\"]\nwsg_port_acknowledge = \"any\"\n";
    let of = |config: Config| config.grippers.into_iter().next().unwrap().wsg_port;
    let addresses = |port: &WsgPort| port.addresses.iter().map(|(address, _)| *address).collect::<Vec<_>>();
    let port = of(file(text).unwrap());
    let tcp = |text: &str| ListenAddress::Tcp(text.parse().unwrap());
    let datagrams = Datagrams { reply_port: Some(1501), lost_after: Duration::from_secs(10) };
    let udp = ListenAddress::Udp("127.0.0.1:1500".parse().unwrap(), datagrams);
    assert_eq!(addresses(&port), [tcp("127.0.0.1:1000"), udp]);
    assert_eq!((port.rules.acknowledge, port.rules.checksum_evaluation), (AcknowledgePolicy::Any, true));

    let parsed = File::parse(Path::new("gateway.toml"), text.to_owned()).unwrap();
    let flags = Flags { wsg_ports: vec!["g=[::1]:1001".to_owned()], ..flags() };
    let port = of(Config::merge(&flags, Some(&parsed)).unwrap());
    assert_eq!((addresses(&port), port.rules.acknowledge), (vec![tcp("[::1]:1001")], AcknowledgePolicy::Any));
}

#[test]
fn non_loopback_wsg_port_needs_allow_list_or_insecure() {
    let text = |more: &str| format!("[grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = \"0.0.0.0:1000\"\n{more}");
    let mistake = file(&text("")).unwrap_err().to_string();
    assert!(mistake.starts_with("gateway.toml:3: 0.0.0.0:1000 is not a loopback address"), "{mistake}");
    assert!(mistake.contains("wsg_port_allow") && mistake.contains("--insecure"), "{mistake}");
    let allowed = file(&text("wsg_port_allow = [\"192.168.1.0/24\", \"10.0.0.7\"]")).unwrap();
    let allow: Vec<_> = allowed.grippers[0].wsg_port.rules.allow.iter().map(ToString::to_string).collect();
    assert_eq!(allow, ["192.168.1.0/24", "10.0.0.7/32"]);
    assert!(
        Config::merge(&Flags { insecure: true, wsg_ports: vec!["left=0.0.0.0:1000".to_owned()], ..flags() }, None)
            .is_ok()
    );
    let mistake = file(&text("wsg_port_allow = [\"192.168.1\"]")).unwrap_err().to_string();
    assert!(mistake.starts_with("gateway.toml:4: \"192.168.1\" is neither an address nor a network"), "{mistake}");
}

#[test]
fn wsg_port_error_names_remedy() {
    let mistake = |text: &str| {
        let flags = Flags { wsg_ports: vec![text.to_owned()], ..flags() };
        Config::load(&flags).unwrap_err().to_string()
    };
    assert!(mistake("127.0.0.1:1000").contains("left=127.0.0.1:1000"));
    assert!(mistake("left=localhost").contains("udp://127.0.0.1:1500?reply_port=1501"));
    assert!(mistake("left=can://can0").contains("127.0.0.1:1000"));
    assert!(mistake("left=udp://127.0.0.1:1500?local_port=1").contains("reply_port"));
    assert!(mistake("left=udp://127.0.0.1?lost_after_ms=1").contains("a number from 100 to 60000"));
    assert!(mistake("middle=127.0.0.1:1000").contains("the grippers are: left, right"));
    let ports = |left: &str, right: &str| {
        let wsg_ports = vec![format!("left={left}"), format!("right={right}")];
        Config::load(&Flags { wsg_ports, ..flags() }).map_err(|error| error.to_string())
    };
    assert!(
        ports("127.0.0.1:1000", "127.0.0.1:1000").unwrap_err().contains("already the address of a WSG port of left")
    );
    assert!(ports("127.0.0.1:1000", "udp://127.0.0.1:1000").is_ok());
    assert!(ports("127.0.0.1:0", "127.0.0.1:0").is_ok());
}

/// A file with a gripper at `url`, and one with WSG ports.
fn two_grippers(url: &str, ports: &str, more: &str) -> String {
    format!("{more}\n[grippers.a]\nurl = \"{url}\"\n[grippers.b]\nurl = \"sim://wsg50\"\nwsg_port = [{ports}]\n")
}

/// With both defaults, a driver on this machine would get its replies at the port where the gripper's arrive.
#[test]
fn reply_port_is_no_port_of_the_gateway() {
    let mistake = file(&two_grippers("udp://10.0.0.5", "\"udp://127.0.0.1\"", "")).unwrap_err().to_string();
    assert!(mistake.starts_with("gateway.toml:6: the WSG port of b sends its replies to UDP port 1501"), "{mistake}");
    assert!(mistake.contains("the local_port of a") && mistake.contains("reply_port=sender"), "{mistake}");
    let quic = "zenoh = { listen = [\"quic/127.0.0.1:1777\"] }";
    for (url, ports, more, owner) in [
        ("udp://10.0.0.5?local_port=1777", "\"udp://127.0.0.1?reply_port=1777\"", "", "the local_port of a"),
        ("sim://wsg50", "\"udp://127.0.0.1:1777?reply_port=1777\"", "", "the UDP WSG port of b"),
        ("sim://wsg50", "\"udp://127.0.0.1?reply_port=5353\"", "mdns = true", "the port of mDNS"),
        ("sim://wsg50", "\"udp://127.0.0.1?reply_port=1777\"", quic, "a Zenoh endpoint"),
    ] {
        let mistake = file(&two_grippers(url, ports, more)).unwrap_err().to_string();
        assert!(mistake.contains(owner), "{mistake}");
    }
    for ports in ["\"udp://127.0.0.1?reply_port=sender\"", "\"udp://127.0.0.1?reply_port=1502\"", "\"127.0.0.1:1501\""]
    {
        assert!(file(&two_grippers("udp://10.0.0.5", ports, "")).is_ok(), "{ports}");
    }
}

/// Some parsers and resolvers read these as other addresses than a person does.
#[test]
fn host_must_be_a_plain_address_everywhere() {
    for host in ["192.168.001.020", "127.1", "0x7f.0.0.8", "2130706440", "192.168.1.300"] {
        let gripper = |line: &str| format!("[grippers.g]\nurl = \"sim://wsg50\"\n{line}");
        for text in [
            format!("[grippers.g]\nurl = \"tcp://{host}:1000\""),
            format!("[grippers.g]\nurl = \"udp://{host}\""),
            format!("listen = \"{host}:8080\""),
            format!("modbus = \"{host}:502\""),
            format!("hosts = [\"{host}\"]"),
            format!("cors_origins = [\"http://{host}\"]"),
            format!("frame_ancestors = [\"http://{host}\"]"),
            format!("public_url = \"http://{host}:8080/\""),
            format!("modbus_allow = [\"{host}\"]\nmodbus = \"127.0.0.1:502\""),
            format!("[zenoh]\nlisten = [\"tcp/{host}:7447\"]"),
            format!(
                "[[webhooks]]\nname = \"mes\"\nurl = \"http://{host}/\"\nsecret = \"whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw\""
            ),
            format!("[[clients]]\nname = \"plc\"\nrole = \"observer\"\naddress = \"{host}\""),
            gripper(&format!("wsg_port = \"{host}:1000\"")),
            gripper(&format!("wsg_port = \"tcp://{host}:1000\"")),
            gripper(&format!("wsg_port = \"udp://{host}:1500\"")),
            gripper(&format!("wsg_port_allow = [\"{host}\"]")),
            gripper(&format!("wsg_port_allow = [\"{host}/32\"]")),
        ] {
            let error = file(&text).map(|_| ()).expect_err(&text).to_string();
            let is_placed = error.starts_with("gateway.toml:");
            assert!(
                is_placed && (error.contains(host) || error.contains("public_url")) && error.contains(": "),
                "{error}"
            );
        }
    }
}

#[test]
fn updates_are_configured_for_each_gripper() {
    let grippers = |text: &str| file(text).unwrap().grippers;
    let text = "[grippers.g]\nurl = \"tcp://10.0.0.1\"\nupdate_period_ms = 50\nupdates = \"changes\"\n";
    let expected = UpdateRules { mode: UpdateMode::Changes, min_period_ms: 50, devices_on_line: 1 };
    assert_eq!(grippers(text)[0].rules.updates, expected);
    assert_eq!(Config::load(&flags()).unwrap().grippers[0].rules.updates, UpdateRules::default());
    let wrong = file(&text.replace("50", "5")).unwrap_err().to_string();
    assert!(wrong.starts_with("gateway.toml:3: update_period_ms is 5; it must be from 10 to 500: "), "{wrong}");
}

#[test]
fn grippers_on_one_can_interface_share_it() {
    let on = |name: &str, interface: &str, tx: u16| {
        format!("[grippers.{name}]\nurl = \"can://{interface}?tx={tx}&rx={}\"\n", tx + 1)
    };
    let text = [on("a", "can0", 2), on("b", "can0", 4), on("c", "can1", 2), on("d", "can0", 6)].concat();
    let shared = file(&text).unwrap().grippers.into_iter().map(|gripper| gripper.rules.updates.devices_on_line);
    assert_eq!(shared.collect::<Vec<_>>(), [3, 3, 1, 3]);
}

#[test]
fn line_that_is_not_utf_8_is_named() {
    let path = std::env::temp_dir().join(format!("wsg-latin-1-{}.toml", std::process::id()));
    std::fs::write(&path, b"listen = \"127.0.0.1:0\"\n# Zelle f\xFCr Teile\nname = \"cell-7\"\n").unwrap();
    let error = File::read(&path).unwrap_err().to_string();
    std::fs::remove_file(&path).unwrap();
    assert!(error.starts_with(&format!("{}:2: ", path.display())), "{error}");
    assert!(error.contains("not UTF-8") && error.contains("save the file as UTF-8"), "{error}");
}

/// The configuration file of the packages.
const PACKAGED: &str = include_str!("../../deploy/wsg-gateway.toml");

#[test]
fn packaged_file_changes_no_default() {
    assert_eq!(file(PACKAGED).unwrap(), Config::load(&flags()).unwrap());
}

#[test]
fn packaged_file_has_every_key_with_a_valid_value() {
    // Files that these keys name must exist, and a webhook has one secret.
    let keys: Vec<_> =
        PACKAGED.lines().filter_map(|line| line.strip_prefix('#')).filter(|line| !line.starts_with(' ')).collect();
    let text: Vec<_> = keys.iter().copied().filter(|line| !super::documents_tests::names_a_file(line)).collect();
    let config = file(&text.join("\n")).unwrap();
    assert_eq!((config.grippers.len(), config.webhooks.len()), (1, 1));
    let sections = ["drift", "zenoh", "webhooks", "mqtt", "grippers", "access", "clients", "tls"];
    for heading in
        ["", "[drift]", "[zenoh]", "[[webhooks]]", "[mqtt]", "[grippers.left]", "[access]", "[[clients]]", "[tls]"]
    {
        let section = format!("{heading}\n");
        let error = file(&format!("{section}nonsense = 1")).unwrap_err().to_string();
        // The first quoted word is the wrong key.
        let quoted = error.split('`').enumerate().filter(|(index, _)| index % 2 == 1 && *index > 2);
        let expected: Vec<_> = quoted.map(|(_, key)| key.to_owned()).collect();
        assert!(expected.len() > 1, "{error}");
        for key in expected {
            let is_section = sections.contains(&key.as_str());
            let is_listed = keys.iter().any(|line| line.starts_with(&format!("{key} = ")));
            assert!(is_section || is_listed, "deploy/wsg-gateway.toml lacks {section}{key}");
        }
    }
}
