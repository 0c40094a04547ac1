//! Invariants of the device under random requests and changes.

use std::collections::HashMap;

use crate::testing::*;
use crate::{BrokenGetter, Change, Device, DeviceConfig, FaultKind, FaultName, FingerConfig, Interface, Model, Part};
use wsg::{Command, Finger, Force, HomingDirection, Reply, SoftLimits, Status, SystemState, id};

const SEEDS: u64 = 60;
const ACTIONS: u32 = 250;

/// Reproducible pseudo-random numbers.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }

    fn mm(&mut self) -> f32 {
        self.below(1300) as f32 / 10.0 - 10.0
    }
}

fn any_command(numbers: &mut Numbers) -> Command {
    let (mm, mm_s) = (numbers.mm(), numbers.below(500) as f32);
    match numbers.below(16) {
        0 | 1 => Command::Homing(HomingDirection::Default),
        2 => Command::Homing(HomingDirection::Inner),
        3 => move_to(mm, mm_s),
        4 => clamp_to(mm, mm_s),
        5 => move_by(mm - 50.0, mm_s),
        6 | 7 => grip(mm, mm_s),
        8 => release(mm, mm_s),
        9 => Command::Stop,
        10 => Command::FastStop,
        11 | 12 => Command::AcknowledgeFastStop,
        13 => Command::SetForceLimit(Force::new(mm).unwrap()),
        14 => match SoftLimits::new(width(mm), width(mm + 60.0)) {
            Some(limits) if numbers.below(4) == 0 => Command::SetSoftLimits(limits),
            _ => Command::ClearSoftLimits,
        },
        _ => Command::FingerPower { finger: Finger::One, on: numbers.below(3) > 0 },
    }
}

fn any_change(numbers: &mut Numbers) -> Change {
    let width_mm = f64::from(numbers.mm());
    match numbers.below(8) {
        0 | 1 => Change::PlacePart(Part::outside(width_mm)),
        2 => Change::PlacePart(Part::inside(width_mm)),
        3 => Change::TakePart,
        4 => Change::SlipPart,
        5 => Change::PlaceObstacle { width_mm },
        6 => Change::RemoveObstacle,
        _ => Change::MoveBySomebody { width_mm, speed_mm_s: 100.0 },
    }
}

fn config(numbers: &mut Numbers) -> DeviceConfig {
    let model = Model::ALL[numbers.below(4) as usize];
    let config = DeviceConfig::new(model);
    if numbers.below(2) == 0 { config } else { config.fw2() }
}

/// Runs a random sequence. Returns its frames with their times in ms since the start.
fn run(seed: u64) -> Vec<(u128, u8, Reply)> {
    let mut numbers = Numbers(seed);
    let mut bench = Bench::new(config(&mut numbers));
    let start = bench.now;
    let stroke_mm = bench.device.config().stroke_mm();
    let mut log = Vec::new();
    for _ in 0..ACTIONS {
        bench.stride = ms(1 + numbers.below(40));
        let mut frames = match numbers.below(4) {
            0 | 1 => {
                let command = any_command(&mut numbers);
                bench.ask(&command)
            }
            2 => {
                bench.apply(any_change(&mut numbers));
                bench.frames()
            }
            _ => Vec::new(),
        };
        let time = ms(numbers.below(400));
        let was_stopped = bench.snapshot().fast_stop;
        frames.extend(bench.pass(time));
        let at = (bench.now - start).as_millis();
        log.extend(frames.into_iter().map(|(id, reply)| (at, id, reply)));

        let snapshot = bench.snapshot();
        assert!((-0.1..=stroke_mm + 0.1).contains(&snapshot.true_width_mm), "seed {seed}: {snapshot:?}");
        assert!(snapshot.force_n.is_finite() && snapshot.force_n <= 200.0, "seed {seed}: {snapshot:?}");
        if was_stopped && time > ms(50) {
            assert!(!snapshot.moving, "seed {seed}: {snapshot:?}");
        }
    }
    // Lets running motions end.
    let rest = bench.pass(ms(60_000));
    let at = (bench.now - start).as_millis();
    log.extend(rest.into_iter().map(|(id, reply)| (at, id, reply)));
    assert!(!bench.snapshot().moving, "seed {seed}");
    log
}

#[test]
fn every_accepted_motion_gets_exactly_one_result() {
    let mut accepted = 0;
    for seed in 0..SEEDS {
        let mut open: HashMap<u8, bool> = HashMap::new();
        for (_, id, reply) in run(seed) {
            if !id::is_motion(id) {
                continue;
            }
            let is_open = open.entry(id).or_default();
            if reply == PENDING {
                assert!(!*is_open, "seed {seed}: accepted twice");
                *is_open = true;
                accepted += 1;
            } else if *is_open && reply.status() != Status::E_ALREADY_RUNNING {
                *is_open = false;
            } else {
                assert!(!reply.status().only_ends_a_motion(), "seed {seed}: {id:02X}h {reply:?} without E_CMD_PENDING");
            }
        }
        assert!(!open.values().any(|is_open| *is_open), "seed {seed}: without a result");
    }
    assert!(accepted > 500, "only {accepted} motions were accepted");
}

#[test]
fn the_same_inputs_give_the_same_frames() {
    for seed in 0..5 {
        assert_eq!(run(seed), run(seed));
    }
}

#[test]
fn random_bytes_do_no_harm() {
    let mut numbers = Numbers(1);
    let mut bench = Bench::new(DeviceConfig::wsg50());
    for _ in 0..2000 {
        // Headers with random ids and small sizes, among random bytes.
        let mut bytes: Vec<u8> = (0..numbers.below(30)).map(|_| numbers.below(256) as u8).collect();
        bytes.extend([0xAA, 0xAA, 0xAA, numbers.below(256) as u8, numbers.below(12) as u8, 0]);
        bench.device.receive(bench.now, &bytes);
        let time = ms(numbers.below(20));
        bench.pass(time);
    }
    bench.pass(ms(60_000));
    assert_eq!(bench.ask(&looped(&[1])).len(), 1);
}

#[test]
fn every_id_and_payload_length_gets_a_reply() {
    for config in [DeviceConfig::wsg50(), DeviceConfig::wsg50().fw2()] {
        for id in (0..=u8::MAX).filter(|&id| id != 0xAA && id != id::DISCONNECT_ANNOUNCEMENT) {
            for length in 0..12 {
                let mut bench = Bench::new(config.clone());
                assert_eq!(bench.ask_raw(id, &vec![0xFF; length]).len(), 1, "{id:02X}h with {length} bytes");
            }
        }
    }
}

#[test]
fn every_kind_of_fault_occurs_and_is_counted() {
    let on_the_wire = [
        FaultKind::CorruptByte,
        FaultKind::CorruptChecksum,
        FaultKind::CorruptSize,
        FaultKind::Garbage,
        FaultKind::PreambleRun,
        FaultKind::FalsePreamble,
        FaultKind::SplitBytes,
        FaultKind::NoReply,
        FaultKind::Status { code: 1 },
        FaultKind::FinalStatus { code: 1 },
        FaultKind::FinalTwice,
        FaultKind::FinalLate { by_ms: 1 },
        FaultKind::FinalWithoutPending,
        FaultKind::FinalBeforePending,
        FaultKind::PendingWithoutFinal,
        FaultKind::SilenceAfterAccept,
        FaultKind::HalfFrame,
        FaultKind::DropConnection,
    ];
    let mut counted = Vec::new();
    for kind in on_the_wire {
        let mut bench = Bench::new(DeviceConfig::wsg50());
        bench.arm(kind, id::HOMING);
        let mut request = Vec::new();
        Command::Homing(HomingDirection::Inner).encode(&mut request);
        bench.device.receive(bench.now, &request);
        for _ in 0..3000 {
            bench.chunks();
            bench.now += ms(1);
            bench.device.handle_timeout(bench.now);
        }
        counted.extend(happened(&bench.device));
    }
    let mut bench = Bench::new(config_with_all_features());
    let mut frames = Vec::new();
    looped(&[1]).encode(&mut frames);
    looped(&[2]).encode(&mut frames);
    bench.arm(FaultKind::JoinFrames, id::LOOP);
    bench.ask_raw(id::LOOP, &[1]);
    bench.device.receive(bench.now, &frames);
    bench.frames();
    bench.home();
    let changes = [
        Change::MoveBySomebody { width_mm: 50.0, speed_mm_s: 100.0 },
        Change::PlaceObstacle { width_mm: 20.0 },
        Change::SlipPart,
        Change::TakePart,
        Change::SetFastStop,
        Change::Overheat { temperature_c: 99.0 },
        Change::CurrentFault { on: true, clears_after_ms: None },
        Change::PowerFault { on: true },
        Change::FingerOverCurrent { finger: 1, on: true },
        Change::FailScript,
        Change::BreakGetter { id: id::LOOP, how: BrokenGetter::NotANumber },
    ];
    for change in changes {
        bench.apply(change);
    }
    bench.ask(&looped(&[1]));
    bench.apply(Change::Silent { on: true });
    bench.ask(&looped(&[1]));
    bench.apply(Change::HalfOpen { on: true });
    bench.ask(&looped(&[1]));
    bench.apply(Change::Reboot { ready_after_ms: 100, mid_frame: false });
    bench.device.connect(bench.now, Interface::Tcp);
    counted.extend(happened(&bench.device));
    for name in FaultName::ALL {
        assert!(counted.contains(name), "{name:?}");
    }
    assert!(bench.has(SystemState::TEMP_FAULT));
}

fn config_with_all_features() -> DeviceConfig {
    let scripts = vec![crate::Script { id: 0xB0, answer: crate::ScriptAnswer::Echo }];
    let fingers = [FingerConfig::Generic, FingerConfig::Generic];
    DeviceConfig { fingers, scripts, ..DeviceConfig::wsg50().with_part(Part::outside(10.0)) }
}

fn happened(device: &Device) -> Vec<FaultName> {
    device.fault_counts().iter().filter(|(_, count)| *count > 0).map(|(name, _)| name).collect()
}
