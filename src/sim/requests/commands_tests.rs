use crate::testing::*;
use crate::{DeviceConfig, FingerConfig, Model, Part, Script, ScriptAnswer};
use wsg::{
    Acceleration, Command, Data, DeviceTag, DeviceType, Finger, FingerFlags, FingerInfo, FingerType, Force, Reply,
    Statistics, Status, SystemState, Temperature, Updates, id,
};

fn force(n: f32) -> Command {
    Command::SetForceLimit(Force::new(n).unwrap())
}

#[test]
fn every_model_returns_its_type_and_limits() {
    let types = [DeviceType::Wsg25, DeviceType::Wsg32, DeviceType::Wsg50, DeviceType::Wsg70];
    for (model, device_type) in Model::ALL.into_iter().zip(types) {
        let config = DeviceConfig::from_model(model.name()).unwrap();
        let mut bench = Bench::new(config.clone());
        let Reply::Success(Data::SystemInfo(info)) = bench.reply(&Command::GetSystemInfo) else { panic!() };
        assert_eq!((info.device_type, info.firmware.major()), (device_type, 4));
        assert_eq!(bench.reply(&Command::GetSystemLimits), Reply::Success(Data::SystemLimits(config.limits)));

        let fw2 = DeviceConfig::from_model(&format!("{}-fw2", model.name())).unwrap();
        let Reply::Success(Data::SystemInfo(info)) = Bench::new(fw2).reply(&Command::GetSystemInfo) else { panic!() };
        assert!(info.device_type.code() <= 1 && info.firmware.major() == 2, "fw2 defines only 0 and 1");
    }
    assert!(DeviceConfig::from_model("wsg51").is_none());
}

#[test]
fn wrong_length_gets_the_manuals_status() {
    let no_param = [0x22, 0x31, 0x33, 0x35, 0x36, 0x38, 0x46, 0x50, 0x52, 0x53, 0x07];
    let format = [0x24, 0x30, 0x32, 0x34, 0x37, 0x40, 0x41, 0x42, 0x43, 0x44, 0x45, 0x60, 0x61, 0x62, 0x63, 0x73];
    let mut bench = Bench::new(DeviceConfig::wsg50());
    for id in no_param {
        assert_eq!(bench.status_of_raw(id, &[0; 11]), Status::E_NO_PARAM_EXPECTED, "{id:02X}h");
    }
    for id in format.into_iter().chain([0x20, 0x21, 0x25, 0x26]) {
        assert_eq!(bench.status_of_raw(id, &[0; 11]), Status::E_CMD_FORMAT_ERROR, "{id:02X}h");
    }
    assert_eq!(bench.status_of_raw(id::LOOP, &[0; 257]), Status::E_CMD_FORMAT_ERROR);
    assert_eq!(bench.status_of_raw(id::SET_DEVICE_TAG, &[b'x'; 65]), Status::E_OVERRUN);
    assert_eq!(bench.status_of_raw(id::SET_DEVICE_TAG, b"a\nb"), Status::E_INVALID_PARAMETER);
}

#[test]
fn unknown_id_gets_unknown_command() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.status_of_raw(0x90, &[]), Status::E_CMD_UNKNOWN);
    assert!(bench.has(SystemState::CMD_FAILURE));
}

#[test]
fn fw2_has_no_temperature_and_no_fingers() {
    let mut bench = Bench::new(DeviceConfig::wsg50().fw2());
    for id in [0x46, 0x60, 0x61, 0x62, 0x63, 0x70, 0x71, 0x72, 0x73] {
        assert_eq!(bench.status_of_raw(id, &[0]), Status::E_CMD_UNKNOWN, "{id:02X}h");
    }
}

#[test]
fn command_failure_flag_follows_last_command() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.reply(&Command::GetSoftLimits);
    let Reply::Success(Data::SystemState(flags)) = bench.reply(&Command::GetSystemState(Updates::Off)) else {
        panic!()
    };
    assert!(flags.contains(SystemState::CMD_FAILURE));
    assert!(!bench.has(SystemState::CMD_FAILURE), "the query itself succeeded");
    bench.run(&grip(20.0, 100.0));
    assert!(bench.has(SystemState::CMD_FAILURE), "a late error counts too");
}

#[test]
fn ruling_loop_data_come_with_success_and_perhaps_a_pending_before() {
    let echo = (id::LOOP, Reply::Success(Data::Loop(vec![0xAA; 256])));
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.ask(&looped(&[0xAA; 256])), [(id::LOOP, Reply::Success(Data::Loop(vec![0xAA; 256])))]);
    let mut bench = Bench::new(DeviceConfig { loop_is_pending: true, ..DeviceConfig::wsg50() });
    assert_eq!(bench.ask(&looped(&[0xAA; 256])), [(id::LOOP, PENDING), echo]);
}

#[test]
fn ruling_get_acceleration_answers_with_its_own_id() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.reply(&Command::SetAcceleration(Acceleration::new(150.0).unwrap()));
    let mut request = Vec::new();
    Command::GetAcceleration.encode(&mut request);
    bench.device.receive(bench.now, &request);
    assert_eq!(bench.chunks(), [hex::decode("AAAAAA3106000000000016431CAF").unwrap()]);
}

#[test]
fn acceleration_and_force_limit_are_clamped() {
    for model in Model::ALL {
        let config = DeviceConfig::new(model);
        let limits = config.limits;
        let mut bench = Bench::new(config);
        for (asked, got) in [(0.0, limits.min_acceleration), (99_999.0, limits.max_acceleration)] {
            bench.reply(&Command::SetAcceleration(Acceleration::new(asked).unwrap()));
            assert_eq!(bench.reply(&Command::GetAcceleration), Reply::Success(Data::Acceleration(got)));
        }
        for (asked, got) in [(-1.0, limits.min_force), (9999.0, limits.nominal_force)] {
            bench.reply(&force(asked));
            assert_eq!(bench.reply(&Command::GetForceLimit), Reply::Success(Data::ForceLimit(got)));
        }
    }
}

#[test]
fn overdrive_raises_the_force_limit_and_leaving_it_lowers_it() {
    for model in [Model::Wsg32, Model::Wsg50, Model::Wsg70] {
        let config = DeviceConfig::new(model);
        let limits = config.limits;
        let mut bench = Bench::new(config);
        assert_eq!(bench.reply(&Command::OverdriveMode { on: true }), DONE);
        assert!(bench.has(SystemState::OVERDRIVE_MODE));
        bench.reply(&force(9999.0));
        let limit = Reply::Success(Data::ForceLimit(limits.overdrive_force));
        assert_eq!(bench.reply(&Command::GetForceLimit), limit);
        bench.reply(&Command::OverdriveMode { on: false });
        assert_eq!(bench.reply(&Command::GetForceLimit), Reply::Success(Data::ForceLimit(limits.nominal_force)));
    }
    let mut bench = Bench::new(DeviceConfig::wsg25());
    assert_eq!(bench.reply(&Command::OverdriveMode { on: true }), status(Status::E_FEATURE_NOT_SUPPORTED));
}

#[test]
fn ruling_statistics_answer_with_42h_and_can_be_reset() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.run(&grip(20.0, 200.0));
    let once = Reply::Success(Data::Statistics(Statistics { total: 1, no_part: 1, lost_part: 0 }));
    assert_eq!(bench.ask(&Command::GetStatistics { reset: false }), [(0x42, once.clone())]);
    assert_eq!(bench.reply(&Command::GetStatistics { reset: true }), once, "read before the reset");
    let none = Reply::Success(Data::Statistics(Statistics::default()));
    assert_eq!(bench.reply(&Command::GetStatistics { reset: false }), none);
}

#[test]
fn ruling_minus_1_1_degrees_is_fff5h() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(crate::Change::Overheat { temperature_c: -1.1 });
    let reply = Reply::Success(Data::Temperature(Temperature(i16::from_le_bytes([0xF5, 0xFF]))));
    assert_eq!(bench.reply(&Command::GetTemperature), reply);
}

#[test]
fn device_tag_is_kept() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.reply(&Command::GetDeviceTag), status(Status::E_NOT_AVAILABLE));
    let tag = DeviceTag::new(b"cell 7").unwrap();
    assert_eq!(bench.reply(&Command::SetDeviceTag(tag.clone())), DONE);
    assert_eq!(bench.reply(&Command::GetDeviceTag), Reply::Success(Data::DeviceTag(tag)));
}

#[test]
fn tare_needs_a_sensor_and_zeroes_it() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.reply(&Command::TareForceSensor), status(Status::E_NOT_AVAILABLE));
    let config = DeviceConfig { force_sensor: true, force_sensor_offset_n: -2.5, ..DeviceConfig::wsg50() };
    let mut bench = Bench::new(config);
    assert!(near(bench.snapshot().force_n, 2.5), "the force has no sign");
    assert_eq!(bench.reply(&Command::TareForceSensor), DONE);
    assert!(near(bench.snapshot().force_n, 0.0));
}

#[test]
fn over_current_while_powering_up_ends_the_request() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    let [on, off] = [true, false].map(|on| Command::FingerPower { finger: Finger::Two, on });
    bench.reply(&off);
    assert_eq!(bench.reply(&on), PENDING);
    bench.pass(ms(100));
    bench.apply(crate::Change::FingerOverCurrent { finger: 2, on: true });
    assert_eq!(bench.frames(), [(id::FINGER_2_POWER, status(Status::E_CMD_FAILED))]);
    assert_eq!(bench.pass(ms(1000)), [], "once");
    assert_eq!(bench.reply(&on), status(Status::E_CMD_FAILED));
    bench.apply(crate::Change::FingerOverCurrent { finger: 2, on: false });
    assert_eq!(bench.run(&on), [PENDING, DONE]);
}

#[test]
fn ruling_finger_info_has_its_size_at_bytes_1_and_2() {
    let fingers = [FingerConfig::Fmf, FingerConfig::Dsa { frame: vec![7; 84] }];
    let mut bench = Bench::new(DeviceConfig { fingers, ..DeviceConfig::wsg50() });
    let info = |finger, finger_type, data_bytes| {
        Reply::Success(Data::FingerInfo(finger, FingerInfo { finger_type, data_bytes }))
    };
    let one = Command::GetFingerInfo(Finger::One);
    assert_eq!(bench.reply(&one), info(Finger::One, FingerType::Fmf, 4));
    let two = Command::GetFingerInfo(Finger::Two);
    assert_eq!(bench.reply(&two), info(Finger::Two, FingerType::Dsa, 84));
    let mut request = Vec::new();
    two.encode(&mut request);
    bench.device.receive(bench.now, &request);
    assert_eq!(bench.chunks()[0][6..11], [0, 0, 2, 84, 0]);
    let data = Reply::Success(Data::FingerData(Finger::Two, vec![7; 84]));
    assert_eq!(bench.reply(&Command::GetFingerData(Finger::Two)), data);
}

#[test]
fn force_finger_returns_its_share_of_force() {
    let fingers = [FingerConfig::Fmf, FingerConfig::Fmf];
    let config = DeviceConfig { fingers, ..DeviceConfig::wsg50() };
    let mut bench = Bench::homed(config.with_part(Part::outside(20.0)));
    bench.run(&grip(20.0, 100.0));
    let Reply::Success(Data::FingerData(_, bytes)) = bench.reply(&Command::GetFingerData(Finger::One)) else {
        panic!()
    };
    assert!(near(f64::from(f32::from_le_bytes(bytes.try_into().unwrap())), 20.0));
}

#[test]
fn ruling_finger_power_is_byte_0_and_on_takes_half_a_second() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    let flags = |bench: &mut Bench| bench.reply(&Command::GetFingerFlags(Finger::Two));
    let powered = |flags| Reply::Success(Data::FingerFlags(Finger::Two, flags));
    assert_eq!(flags(&mut bench), powered(FingerFlags::POWER_ON), "powered at start");
    assert_eq!(bench.status_of_raw(id::FINGER_2_POWER, &[0]), Status::E_SUCCESS);
    assert_eq!(flags(&mut bench), powered(FingerFlags::empty()));
    assert_eq!(bench.status_of_raw(id::FINGER_2_POWER, &[1]), Status::E_CMD_PENDING);
    assert_eq!(bench.pass(ms(499)), []);
    assert_eq!(bench.pass(ms(1)), [(id::FINGER_2_POWER, DONE)]);
    assert_eq!(flags(&mut bench), powered(FingerFlags::POWER_ON));
    assert_eq!(bench.status_of_raw(id::FINGER_2_POWER, &[2]), Status::E_INVALID_PARAMETER);
}

#[test]
fn switching_finger_off_aborts_power_up() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    let power = |on| Command::FingerPower { finger: Finger::One, on };
    bench.ask(&power(true));
    let frames = bench.ask(&power(false));
    assert_eq!(frames, [(id::FINGER_1_POWER, status(Status::E_CMD_ABORTED)), (id::FINGER_1_POWER, DONE)]);
    assert_eq!(bench.pass(ms(1000)), []);
}

#[test]
fn only_generic_fingers_can_be_switched() {
    let fingers = [FingerConfig::Fmf, FingerConfig::None];
    let mut bench = Bench::new(DeviceConfig { fingers, ..DeviceConfig::wsg50() });
    let off = Command::FingerPower { finger: Finger::One, on: false };
    assert_eq!(bench.reply(&off), status(Status::E_NOT_AVAILABLE));
    let intelligent = FingerFlags::POWER_ON | FingerFlags::CONFIG_AVAIL | FingerFlags::COMM_OPEN;
    let flags = Reply::Success(Data::FingerFlags(Finger::One, intelligent));
    assert_eq!(bench.reply(&Command::GetFingerFlags(Finger::One)), flags);
    assert_eq!(bench.reply(&Command::GetFingerData(Finger::Two)), status(Status::E_NOT_AVAILABLE));
}

#[test]
fn scripts_add_commands_while_they_run() {
    let scripts = vec![
        Script { id: 0xB0, answer: ScriptAnswer::Echo },
        Script { id: 0xB1, answer: ScriptAnswer::Measurement },
        Script { id: 0xB2, answer: ScriptAnswer::Status(18) },
        Script { id: 0xBB, answer: ScriptAnswer::Bytes(vec![0xAA; 3]) },
    ];
    let mut bench = Bench::new(DeviceConfig { scripts, ..DeviceConfig::wsg50() });
    assert!(bench.has(SystemState::SCRIPT_RUNNING));
    let custom = |bytes: &[u8]| Reply::Success(Data::Custom(bytes.to_vec()));
    assert_eq!(bench.ask_raw(0xB0, &[1, 2]), [(0xB0, custom(&[1, 2]))]);
    assert_eq!(bench.ask_raw(0xB1, &[]), [(0xB1, custom(&[0; 13]))]);
    assert_eq!(bench.status_of_raw(0xB2, &[]), Status::E_CMD_FAILED);
    assert_eq!(bench.ask_raw(0xBB, &[]), [(0xBB, custom(&[0xAA; 3]))]);
    bench.apply(crate::Change::FailScript);
    assert!(bench.has(SystemState::SCRIPT_FAILURE) && !bench.has(SystemState::SCRIPT_RUNNING));
    assert_eq!(bench.status_of_raw(0xB0, &[]), Status::E_CMD_UNKNOWN);
    bench.apply(crate::Change::StartScript);
    assert_eq!(bench.ask_raw(0xB0, &[]), [(0xB0, custom(&[]))]);
    assert!(!bench.has(SystemState::SCRIPT_FAILURE));
}
