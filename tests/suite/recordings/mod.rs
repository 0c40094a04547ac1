//! Recordings in `tests/recordings/` of every command on each transport, as sent on the wire. `>` goes to the device,
//! `<` comes from the device. A line is a datagram on UDP, a CAN frame in `candump` format, and a protocol frame
//! elsewhere.
//!
//! `RECORD=1 cargo test --test suite as_recorded` rewrites them; review the difference.

use std::fmt::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use wsg_gateway::sim::{Device, Interface};
use wsg_gateway::transport::can::segment;
use wsg_gateway::wsg::{
    Acceleration, Command, CustomCommand, DeviceTag, Finger, Force, HomingDirection, LoopData, MoveFlags, SoftLimits,
    Speed, Updates, Width,
};

use crate::conformance::rig;

pub const TRANSPORTS: [(&str, Interface); 4] =
    [("tcp", Interface::Tcp), ("udp", Interface::Udp), ("serial", Interface::Serial), ("can", Interface::Can)];

/// A request and its replies, as lines of the recording.
#[derive(Debug, Default)]
pub struct Exchange {
    pub requests: Vec<String>,
    pub replies: Vec<String>,
}

impl Exchange {
    pub fn request_bytes(&self) -> Vec<u8> {
        self.requests.iter().flat_map(|line| bytes(line)).collect()
    }

    pub fn reply_bytes(&self) -> Vec<u8> {
        self.replies.iter().flat_map(|line| bytes(line)).collect()
    }
}

/// Bytes of a line, without the id of a CAN frame.
pub fn bytes(line: &str) -> Vec<u8> {
    hex::decode(line.rsplit('#').next().unwrap()).unwrap()
}

/// Id and data of a CAN frame.
pub fn can_frame(line: &str) -> (&str, Vec<u8>) {
    (line.split('#').next().unwrap(), bytes(line))
}

fn path(transport: &str) -> PathBuf {
    // A test binary on another machine brings the recordings along.
    let folder = std::env::var_os("WSG_TEST_RECORDINGS").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recordings").into());
    folder.join(format!("{transport}.txt"))
}

/// Reads the exchanges of a recording.
pub fn read(transport: &str) -> Vec<Exchange> {
    let text = std::fs::read_to_string(path(transport)).unwrap();
    let mut exchanges: Vec<Exchange> = Vec::new();
    for line in text.lines() {
        match line.split_at_checked(2) {
            Some(("> ", line)) => exchanges.last_mut().unwrap().requests.push(line.to_owned()),
            Some(("< ", line)) => exchanges.last_mut().unwrap().replies.push(line.to_owned()),
            _ => exchanges.push(Exchange::default()),
        }
    }
    exchanges
}

/// One of each command, in an order that a device can follow.
fn commands() -> Vec<Command> {
    let (width, speed) = (Width::new(30.0).unwrap(), Speed::new(200.0).unwrap());
    let flags = MoveFlags { relative: false, stop_on_block: true };
    let grip = Command::Grip { width: Width::new(20.0).unwrap(), speed };
    let mut commands = vec![
        Command::GetSystemInfo,
        Command::GetSystemLimits,
        Command::SetDeviceTag(DeviceTag::new(b"cell 7").unwrap()),
        Command::GetDeviceTag,
        Command::Loop(LoopData::new((0..20).collect()).unwrap()),
        Command::Homing(HomingDirection::Default),
        Command::PrePosition { flags, width, speed },
        grip,
        Command::Release { width, speed },
        Command::Stop,
        Command::FastStop,
        Command::AcknowledgeFastStop,
        Command::SetAcceleration(Acceleration::new(1500.0).unwrap()),
        Command::GetAcceleration,
        Command::SetForceLimit(Force::new(35.0).unwrap()),
        Command::GetForceLimit,
        Command::SetSoftLimits(SoftLimits::new(Width::new(5.0).unwrap(), width).unwrap()),
        Command::GetSoftLimits,
        Command::ClearSoftLimits,
        Command::OverdriveMode { on: true },
        Command::TareForceSensor,
        Command::GetSystemState(Updates::Off),
        Command::GetGripperState(Updates::Off),
        Command::GetStatistics { reset: false },
        Command::GetWidth(Updates::Off),
        Command::GetSpeed(Updates::Off),
        Command::GetForce(Updates::Off),
        Command::GetTemperature,
    ];
    for finger in [Finger::One, Finger::Two] {
        commands.extend([
            Command::GetFingerInfo(finger),
            Command::GetFingerFlags(finger),
            Command::FingerPower { finger, on: true },
            Command::GetFingerData(finger),
        ]);
    }
    commands.push(Command::Custom(CustomCommand::new(0xB0, b"opaque".to_vec()).unwrap()));
    commands.push(Command::DisconnectAnnouncement);
    commands
}

fn write_frame(out: &mut String, mark: char, interface: Interface, id: &str, frame: &[u8]) {
    if interface == Interface::Can {
        for slice in segment::slices(frame) {
            writeln!(out, "{mark} {id}#{}", hex::encode_upper(slice)).unwrap();
        }
    } else {
        writeln!(out, "{mark} {}", hex::encode_upper(frame)).unwrap();
    }
}

/// Records the exchanges with a device on this interface, on a virtual clock.
pub fn record(interface: Interface) -> String {
    let mut now = Instant::now();
    let mut device = Device::new(rig::device(), now);
    assert!(device.connect(now, interface));
    let mut text = String::new();
    for command in commands() {
        writeln!(text, "# {command:?}").unwrap();
        let mut frame = Vec::new();
        command.encode(&mut frame);
        write_frame(&mut text, '>', interface, "064", &frame);
        device.receive(now, &frame);
        // Longer than any of these motions.
        for _ in 0..3000 {
            now += Duration::from_millis(1);
            device.handle_timeout(now);
            frame.clear();
            while device.poll_transmit(&mut frame) {
                write_frame(&mut text, '<', interface, "065", &frame);
                frame.clear();
            }
        }
    }
    text
}

/// Compares a recording with the current behaviour, or rewrites it.
pub fn compare(transport: &str, interface: Interface) {
    let recorded = record(interface);
    if std::env::var_os("RECORD").is_some() {
        std::fs::write(path(transport), &recorded).unwrap();
    }
    let expected = std::fs::read_to_string(path(transport)).unwrap();
    assert!(
        recorded == expected,
        "{transport} differs from its recording: RECORD=1 rewrites it, git shows the difference"
    );
}
