//! Unusual spellings of FAST STOPs and other requests.

use std::io::Write as _;

use crate::device::Device;
use crate::gateway::{Gateway, Limits};
use crate::http;
use crate::probe::Probe;
use crate::websocket::{BINARY, Socket, TEXT, upgrade};

fn with_probe(test: impl FnOnce(&Gateway, &Probe<'_>)) {
    let g = Device::start();
    let gateway = Gateway::of(&g, Limits::Inherited);
    test(&gateway, &Probe::of(&gateway, &g));
}

#[test]
fn fast_stop_in_a_binary_frame_stops() {
    with_probe(|gateway, probe| {
        let request = r#"{"jsonrpc": "2.0", "id": 1, "method": "fast-stop", "params": {"gripper": "g"}}"#;
        for opcode in [TEXT, BINARY] {
            let mut socket = Socket::open(gateway).unwrap();
            assert!(probe.reaches(|| socket.send(opcode, request).unwrap()), "opcode {opcode}");
        }
    });
}

#[test]
fn fast_stop_with_a_trailing_slash_stops() {
    with_probe(|gateway, probe| {
        for path in ["/api/v1/fast-stop", "/api/v1/fast-stop/", "/api/v1/grippers/g/fast-stop/"] {
            let mut status = None;
            let reached = probe.reaches(|| status = http::post(gateway.address, path, "").map(|answer| answer.status));
            assert_eq!((reached, status), (true, Some(200)), "{path}");
        }
    });
}

#[test]
fn empty_host_counts_as_absent() {
    with_probe(|gateway, _| {
        for head in ["GET /api/v1/grippers HTTP/1.0\r\n\r\n", "GET /api/v1/grippers HTTP/1.1\r\nHost: \r\n\r\n"] {
            let answer = http::ask(&mut gateway.connect().unwrap(), head).unwrap();
            assert_eq!(answer.status, 200, "{head}: {}", answer.body);
        }
    });
}

#[test]
fn malformed_websocket_key_is_refused() {
    with_probe(|gateway, _| {
        for key in ["", "x", "dGhlIHNhbXBsZSBub25jZQ", "dGhlIHNhbXBsZSBub25jZSBpcyBsb25n", "!!!!!!!!!!!!!!!!!!!!!!=="] {
            let mut stream = gateway.connect().unwrap();
            stream.write_all(upgrade(key).as_bytes()).unwrap();
            let answer = http::read_answer(&mut stream).unwrap();
            assert_eq!(answer.status, 400, "the key {key:?}: {}", answer.body);
        }
    });
}
