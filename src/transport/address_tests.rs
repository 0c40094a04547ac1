use super::*;

#[test]
fn urls_survive_a_round_trip() {
    for (text, written) in [
        ("tcp://192.168.1.20:1000", "tcp://192.168.1.20:1000"),
        ("tcp://gripper.cell7", "tcp://gripper.cell7:1000"),
        ("tcp://[::1]:1234/", "tcp://[::1]:1234"),
        ("udp://10.0.0.5", "udp://10.0.0.5:1500?local_port=1501"),
        ("tcp://Gripper.Cell7:1000", "tcp://gripper.cell7:1000"),
        ("udp://[2001:db8::1]:9?local_port=10", "udp://[2001:db8::1]:9?local_port=10"),
        ("tcp://[fe80::1%25eth0]:1000", "tcp://[fe80::1%25eth0]:1000"),
        ("tcp://[FE80::01%eth0.7]", "tcp://[fe80::1%25eth0.7]:1000"),
        ("udp://[fe80::1%2]", "udp://[fe80::1%252]:1500?local_port=1501"),
        ("serial:///dev/ttyUSB0", "serial:///dev/ttyUSB0?baud=115200&stop_bits=1"),
        ("serial:///dev/ttyS1?stop_bits=2&baud=9600", "serial:///dev/ttyS1?baud=9600&stop_bits=2"),
        ("serial:///dev/Prüfplatz 3", "serial:///dev/Pr%C3%BCfplatz%203?baud=115200&stop_bits=1"),
        ("serial:///dev/Pr%C3%BCfplatz%203", "serial:///dev/Pr%C3%BCfplatz%203?baud=115200&stop_bits=1"),
        ("serial:///dev/a%3Fb%23c%25d?baud=9600", "serial:///dev/a%3Fb%23c%25d?baud=9600&stop_bits=1"),
        ("can://can0", "can://can0?tx=0x64&rx=0x65"),
        ("can://vcan1?tx=1024&rx=0x7FF&bitrate=1000000", "can://vcan1?tx=0x400&rx=0x7ff&bitrate=1000000"),
    ] {
        let address: Address = text.parse().unwrap();
        assert_eq!(address.to_string(), written);
        assert_eq!(address.to_string().parse::<Address>().unwrap(), address);
    }
}

#[test]
fn serial_path_is_decoded() {
    for text in ["serial:///dev/Prüfplatz 3?baud=9600", "serial:///dev/Pr%C3%BCfplatz%203?baud=9600"] {
        let Ok(Address::Serial(address)) = text.parse() else { panic!("{text}") };
        assert_eq!(address.path, "/dev/Prüfplatz 3");
    }
}

#[track_caller]
fn mistake(text: &str, parts: &[&str]) {
    let message = text.parse::<Address>().unwrap_err().to_string();
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message}");
    }
}

#[test]
fn errors_name_mistake_and_remedy() {
    mistake("192.168.1.20:1000", &["tcp://192.168.1.20:1000"]);
    mistake("http://host", &["unknown transport", "tcp, udp, serial, can"]);
    mistake("tcp://host:0", &["port 0"]);
    mistake("tcp://:1000", &["tcp://"]);
    mistake("tcp://host:70000", &["port"]);
    mistake("tcp://user@host", &["user and password"]);
    mistake("tcp://host#there", &["#"]);
    mistake("udp://0.0.0.0", &["0.0.0.0 is the unspecified address", "udp://192.168.1.20:1500"]);
    mistake("udp://[::]", &[":: is the unspecified address"]);
    mistake("udp://239.1.2.3:1500", &["239.1.2.3 is a multicast address"]);
    mistake("udp://[ff02::1]", &["ff02::1 is a multicast address"]);
    mistake("udp://255.255.255.255", &["255.255.255.255 is the broadcast address"]);
    mistake("tcp://0.0.0.0", &["0.0.0.0 is the unspecified address", "tcp://192.168.1.20:1000"]);
    for host in ["192.168.001.020", "127.1", "0x7f.0.0.8", "2130706440", "192.168.1.300"] {
        mistake(&format!("tcp://{host}:1000"), &[host, "not a plain IPv4 address", "without leading zeros"]);
        mistake(&format!("udp://{host}"), &[host, "not a plain IPv4 address", "such as 192.168.1.20"]);
    }
    mistake("tcp://[fe80::1]:1000", &["link-local", "[fe80::1%25eth0]"]);
    mistake("udp://[2001:db8::1%25eth0]", &["not a link-local address", "leave out the zone %eth0"]);
    mistake("tcp://[fe80::1%25a/b]", &["\"a/b\" is not the name of a network interface"]);
    mistake("serial://ttyUSB0", &["three slashes", "serial:///dev/ttyUSB0"]);
    mistake("serial:///", &["port is missing"]);
    mistake("serial:ttyUSB0", &["port is missing"]);
    mistake("serial:///dev/a%00b", &["not UTF-8 text"]);
    mistake("serial:///dev/Pr%FCf", &["not UTF-8 text"]);
    mistake("can://", &["can0"]);
    mistake("can://an-interface-with-a-long-name", &["interface is missing or invalid"]);
}

#[test]
fn option_errors_name_allowed_values() {
    mistake("tcp://host:1000?baud=9600", &["\"baud\"", "known options: none"]);
    mistake("udp://host?port=1", &["\"port\"", "local_port"]);
    mistake("udp://host?local_port=0", &["local_port=0", "1 to 65535"]);
    mistake("udp://host?local_port=1&local_port=2", &["local_port is given twice"]);
    mistake("serial:///dev/ttyS0?baud=12345", &["baud=12345", "1200", "460800"]);
    mistake("serial:///dev/ttyS0?stop_bits=1.5", &["stop_bits=1.5", "1, 2"]);
    mistake("serial:///dev/ttyS0?parity=even", &["\"parity\"", "baud, stop_bits"]);
    mistake("can://can0?tx=0x800", &["tx=0x800", "0x0 to 0x7FF"]);
    mistake("can://can0?rx=five", &["rx=five", "0 to 2047"]);
    mistake("can://can0?tx=0x65", &["both", "0x65"]);
    mistake("can://can0?bitrate=9600", &["bitrate=9600", "10000 to 1000000"]);
}

#[test]
fn properties_give_connections_and_line_rates() {
    let properties = |text: &str| text.parse::<Address>().unwrap().properties();
    assert!(properties("tcp://h").connection_oriented);
    for (text, bytes_per_second) in [
        ("udp://h", None),
        ("serial:///dev/ttyS0?baud=9600", Some(960)),
        ("serial:///dev/ttyS0?stop_bits=2", Some(10_472)),
        ("can://can0", Some(23_809)),
    ] {
        let properties = properties(text);
        assert!(!properties.connection_oriented);
        assert_eq!(properties.bytes_per_second, bytes_per_second, "{text}");
    }
}

#[test]
fn conflicting_addresses_give_reason() {
    let conflict = |one: &str, other: &str| {
        let [one, other] = [one, other].map(|text| text.parse::<Address>().unwrap());
        let why = one.conflict_with(&other);
        assert_eq!(why.is_some(), other.conflict_with(&one).is_some(), "{one} {other}: in either order");
        why.unwrap_or_default()
    };
    for (one, other, why) in [
        ("tcp://h", "tcp://h:1000", "both are at tcp://h:1000, but a device accepts only one client"),
        ("udp://h?local_port=5", "udp://i?local_port=5", "both listen on UDP port 5"),
        ("udp://h?local_port=5", "udp://h?local_port=6", "a device accepts only one client"),
        ("serial:///dev/ttyS0", "serial:///dev/ttyS0?baud=9600", "a device accepts only one client"),
        ("can://can0?tx=1&rx=2", "can://can0?tx=1&rx=3", "the id 0x1 on can0"),
        ("can://can0?tx=1&rx=2", "can://can0?tx=3&rx=2", "the id 0x2 on can0"),
        ("can://can0?tx=1&rx=2", "can://can0?tx=2&rx=3", "the id 0x2 on can0"),
    ] {
        assert!(conflict(one, other).contains(why), "{one} {other}: {}", conflict(one, other));
    }
    for (one, other) in [
        ("tcp://h:1", "tcp://h:2"),
        ("tcp://h:1500", "udp://h:1500"),
        ("udp://h", "udp://i?local_port=1502"),
        ("serial:///dev/ttyS0", "serial:///dev/ttyS1"),
        ("can://can0?tx=1&rx=2", "can://can0?tx=3&rx=4"),
        ("can://can0?tx=1&rx=2", "can://can1?tx=1&rx=2"),
    ] {
        assert_eq!(conflict(one, other), "");
    }
}

#[tokio::test]
async fn missing_port_or_interface_lists_available_ones() {
    let refused = async |text: &str| text.parse::<Address>().unwrap().connect().await.unwrap_err().to_string();
    let serial = refused("serial:///dev/ttyNONE9").await;
    assert!(serial.contains("/dev/ttyNONE9 does not exist; "), "{serial}");
    let can = refused("can://nocan9").await;
    assert!(can.contains("nocan9 cannot be opened") && (can.contains("no CAN") || can.contains("available")), "{can}");
}
