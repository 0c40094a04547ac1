use crate::testing::*;
use crate::{Change, DeviceConfig, FaultKind, FaultName, FingerConfig, Interface, LinkAction, Part};
use wsg::{
    Acceleration, Command, Data, DeviceTag, Finger, FingerFlags, Force, GripperState, Reply, SoftLimits, Status,
    SystemState, Temperature, id,
};

fn acceleration(mm_s2: f32) -> Command {
    Command::SetAcceleration(Acceleration::new(mm_s2).unwrap())
}

#[test]
fn changes_survive_json() {
    let changes = [
        Change::PlacePart(Part::inside(40.0)),
        Change::CurrentFault { on: true, clears_after_ms: Some(500) },
        Change::Fault { kind: FaultKind::FinalLate { by_ms: 20 }, id: Some(0x25), times: 3 },
        Change::TakePart,
    ];
    for change in changes {
        let json = serde_json::to_string(&change).unwrap();
        assert_eq!(serde_json::from_str::<Change>(&json).unwrap(), change, "{json}");
    }
}

#[test]
fn overheating_warns_then_stops() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.apply(Change::Overheat { temperature_c: 75.0 });
    assert!(bench.has(SystemState::TEMP_WARNING) && !bench.has_any(SystemState::TEMP_FAULT | SystemState::FAST_STOP));
    bench.ask(&move_to(20.0, 50.0));
    bench.apply(Change::Overheat { temperature_c: 90.0 });
    assert_eq!(bench.pass(ms(50)), [(id::PRE_POSITION, status(Status::E_CMD_ABORTED))]);
    assert!(bench.has(SystemState::TEMP_FAULT | SystemState::FAST_STOP));
    assert_eq!(bench.happened(FaultName::TemperatureFault), 1);
    assert_eq!(bench.state(), GripperState::Error);
}

#[test]
fn ruling_an_acknowledge_before_the_fault_has_cleared_leaves_the_fast_stop() {
    let cases = [
        (Change::Overheat { temperature_c: 90.0 }, Change::Cool),
        (
            Change::CurrentFault { on: true, clears_after_ms: None },
            Change::CurrentFault { on: false, clears_after_ms: None },
        ),
        (Change::PowerFault { on: true }, Change::PowerFault { on: false }),
    ];
    for config in [DeviceConfig::wsg50(), DeviceConfig::wsg50().fw2()] {
        for (fault, cure) in &cases {
            let mut bench = Bench::homed(config.clone());
            bench.apply(fault.clone());
            assert_eq!(bench.reply(&Command::AcknowledgeFastStop), DONE, "the status alone does not show it");
            assert!(bench.has(SystemState::FAST_STOP));
            assert_eq!(bench.reply(&move_to(50.0, 50.0)), status(Status::E_ACCESS_DENIED));
            bench.apply(cure.clone());
            assert!(bench.has(SystemState::FAST_STOP) && !bench.has_any(SystemState::FAULTS));
            assert_eq!(bench.reply(&Command::AcknowledgeFastStop), DONE);
            assert_eq!(bench.run(&move_to(50.0, 50.0)), [PENDING, DONE]);
        }
    }
}

#[test]
fn current_fault_clears_by_itself() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::CurrentFault { on: true, clears_after_ms: Some(300) });
    bench.pass(ms(299));
    assert!(bench.has(SystemState::CURR_FAULT));
    bench.pass(ms(1));
    assert!(!bench.has(SystemState::CURR_FAULT) && bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.happened(FaultName::CurrentFault), 1);
}

#[test]
fn fast_stop_can_be_set_without_client() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::SetFastStop);
    assert!(bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.happened(FaultName::FastStop), 1);
}

#[test]
fn finger_faults_show_in_both_flags() {
    let dsa = FingerConfig::Dsa { frame: vec![1, 2, 3] };
    let fingers = [FingerConfig::Generic, dsa];
    let mut bench = Bench::new(DeviceConfig { fingers, ..DeviceConfig::wsg50() });
    bench.apply(Change::FingerCommunicationFault { finger: 2, on: true });
    assert!(bench.has(SystemState::FINGER_FAULT) && !bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.reply(&Command::GetFingerData(Finger::Two)), status(Status::E_IO_ERROR));
    bench.apply(Change::FingerCommunicationFault { finger: 2, on: false });
    assert!(!bench.has(SystemState::FINGER_FAULT));
    bench.apply(Change::FingerOverCurrent { finger: 1, on: true });
    let flags = Reply::Success(Data::FingerFlags(Finger::One, FingerFlags::POWER_FAULT));
    assert_eq!(bench.reply(&Command::GetFingerFlags(Finger::One)), flags);
    let power_on = Command::FingerPower { finger: Finger::One, on: true };
    assert_eq!(bench.reply(&power_on), status(Status::E_CMD_FAILED));
    assert_eq!(bench.happened(FaultName::FingerFault), 2);
}

#[test]
fn foreign_motion_is_visible_but_not_answered() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.apply(Change::MoveBySomebody { width_mm: 50.0, speed_mm_s: 100.0 });
    assert!(bench.has(SystemState::MOVING));
    assert_eq!(bench.reply(&move_to(20.0, 50.0)), status(Status::E_ALREADY_RUNNING));
    assert_eq!(bench.pass(ms(1000)), []);
    assert!(near(bench.snapshot().width_mm, 50.0));
    assert_eq!(bench.happened(FaultName::ForeignMotion), 1);
    bench.ask(&Command::FastStop);
    bench.apply(Change::MoveBySomebody { width_mm: 20.0, speed_mm_s: 100.0 });
    assert!(!bench.snapshot().moving, "a FAST STOP blocks it");
    assert_eq!(bench.happened(FaultName::ForeignMotion), 1);
}

#[test]
fn reboot_keeps_only_tag_and_statistics() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.reply(&acceleration(1234.0));
    bench.reply(&Command::SetForceLimit(Force::new(77.0).unwrap()));
    bench.reply(&Command::OverdriveMode { on: true });
    bench.reply(&Command::SetSoftLimits(SoftLimits::new(width(5.0), width(109.5)).unwrap()));
    bench.reply(&Command::SetDeviceTag(DeviceTag::new(b"cell 7").unwrap()));
    bench.run(&grip(20.0, 100.0));
    bench.ask(&Command::GetSpeed(updates(false, 10)));
    bench.ask(&Command::FastStop);
    bench.apply(Change::Reboot { ready_after_ms: 2000, mid_frame: false });
    assert_eq!(bench.device.poll_link(), Some(LinkAction::Drop));
    assert!(!bench.device.connect(bench.now, Interface::Tcp), "rejected while booting");
    assert_eq!(bench.pass(ms(2000)), []);
    assert!(bench.device.connect(bench.now, Interface::Tcp));

    let snapshot = bench.snapshot();
    assert!(near(snapshot.acceleration_mm_s2, 2500.0) && near(snapshot.force_limit_n, 40.0));
    assert!(!snapshot.referenced && !snapshot.fast_stop && !snapshot.overdrive);
    assert_eq!((snapshot.soft_limits, snapshot.updates), (None, vec![]));
    assert_eq!((snapshot.statistics.total, snapshot.device_tag.as_deref()), (1, Some("cell 7")));
    assert!(near(snapshot.true_width_mm, 17.0) && near(snapshot.width_mm, 0.0));
    assert_eq!(bench.happened(FaultName::Reboot), 1);
    bench.home();
}

#[test]
fn reboot_ends_motion_without_result() {
    let mut bench = Bench::on(DeviceConfig::wsg50(), Interface::Serial);
    bench.home();
    bench.ask(&move_to(20.0, 50.0));
    bench.pass(ms(200));
    bench.apply(Change::Reboot { ready_after_ms: 100, mid_frame: false });
    assert_eq!(bench.device.poll_link(), None, "no connection to drop");
    assert_eq!(bench.pass(ms(3000)), []);
    assert!(!bench.snapshot().moving);
    assert_eq!(bench.reply(&looped(&[1])), Reply::Success(Data::Loop(vec![1])));
    assert_eq!(bench.reply(&move_to(20.0, 50.0)), status(Status::E_NOT_INITIALIZED));
}

#[test]
fn fault_after_reboot_triggers_fast_stop_again() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::PowerFault { on: true });
    bench.apply(Change::Reboot { ready_after_ms: 100, mid_frame: false });
    assert!(!bench.has(SystemState::FAST_STOP));
    bench.pass(ms(100));
    assert!(bench.has(SystemState::FAST_STOP | SystemState::POWER_FAULT));
}

#[test]
fn reboot_can_cut_frame_in_half() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::Reboot { ready_after_ms: 100, mid_frame: true });
    let chunks = bench.chunks();
    assert_eq!((chunks.len(), chunks[0].len()), (1, 7));
}

#[test]
fn silent_device_acts_without_replies() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::Silent { on: true });
    assert_eq!(bench.ask(&acceleration(1234.0)), []);
    assert!(near(bench.snapshot().acceleration_mm_s2, 1234.0));
    bench.device.disconnect(bench.now);
    assert!(bench.device.connect(bench.now, Interface::Tcp));
    assert_eq!(bench.ask(&looped(&[1])), [], "silent to the next client too");
    bench.apply(Change::Silent { on: false });
    assert_eq!(bench.ask(&looped(&[1])).len(), 1);
    assert_eq!(bench.happened(FaultName::Silent), 2);
}

#[test]
fn connection_can_be_cut() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::CutConnection);
    assert_eq!(bench.device.poll_link(), Some(LinkAction::Drop));
    bench.device.disconnect(bench.now);
    assert!(bench.has(SystemState::FAST_STOP));
}

#[test]
fn force_heats_device_and_overdrive_overheats_it() {
    let run = |force_n: f32| {
        let mut bench = Bench::homed(DeviceConfig::wsg50().with_part(Part::outside(20.0)));
        bench.reply(&Command::OverdriveMode { on: true });
        bench.reply(&Command::SetForceLimit(Force::new(force_n).unwrap()));
        bench.run(&grip(20.0, 100.0));
        assert_eq!(bench.state(), GripperState::Holding);
        bench.now += ms(3_600_000);
        bench.device.handle_timeout(bench.now);
        bench.reply(&Command::GetTemperature)
    };
    let Reply::Success(Data::Temperature(Temperature(nominal))) = run(80.0) else { panic!() };
    let Reply::Success(Data::Temperature(Temperature(overdrive))) = run(120.0) else { panic!() };
    assert!((450..600).contains(&nominal), "{nominal}");
    assert!(overdrive > 700, "{overdrive}");
}
