use super::*;

fn width(mm: f32) -> Width {
    Width::new(mm).unwrap()
}

fn speed(mm_s: f32) -> Speed {
    Speed::new(mm_s).unwrap()
}

fn updates() -> Updates {
    Updates::On { on_change: true, period_ms: 10 }
}

/// One command of each kind, for both fingers.
pub(crate) fn every_command() -> Vec<Command> {
    let flags = MoveFlags { relative: true, stop_on_block: true };
    let mut commands = vec![
        Command::Loop(LoopData::new(vec![0xAA; 256]).unwrap()),
        Command::DisconnectAnnouncement,
        Command::Homing(HomingDirection::Inner),
        Command::PrePosition { flags, width: width(-5.0), speed: speed(50.0) },
        Command::Stop,
        Command::FastStop,
        Command::AcknowledgeFastStop,
        Command::Grip { width: width(20.0), speed: speed(50.0) },
        Command::Release { width: width(60.0), speed: speed(100.0) },
        Command::SetAcceleration(Acceleration::new(500.0).unwrap()),
        Command::GetAcceleration,
        Command::SetForceLimit(Force::new(40.0).unwrap()),
        Command::GetForceLimit,
        Command::SetSoftLimits(SoftLimits::new(width(5.0), width(90.0)).unwrap()),
        Command::GetSoftLimits,
        Command::ClearSoftLimits,
        Command::OverdriveMode { on: true },
        Command::TareForceSensor,
        Command::GetSystemState(updates()),
        Command::GetGripperState(Updates::Off),
        Command::GetStatistics { reset: true },
        Command::GetWidth(updates()),
        Command::GetSpeed(updates()),
        Command::GetForce(updates()),
        Command::GetTemperature,
        Command::GetSystemInfo,
        Command::SetDeviceTag(DeviceTag::new(b"cell 7").unwrap()),
        Command::GetDeviceTag,
        Command::GetSystemLimits,
        Command::Custom(CustomCommand::new(0xB0, vec![1, 2, 3]).unwrap()),
    ];
    for finger in [Finger::One, Finger::Two] {
        commands.extend([
            Command::GetFingerInfo(finger),
            Command::GetFingerFlags(finger),
            Command::FingerPower { finger, on: true },
            Command::GetFingerData(finger),
        ]);
    }
    commands
}

#[test]
fn every_command_survives_a_round_trip() {
    let commands = every_command();
    let mut ids: Vec<_> = commands.iter().map(Command::id).filter(|&id| id != 0xB0).collect();
    ids.sort_unstable();
    assert!(ids.iter().copied().eq(id::COMMANDS.iter().map(|row| row.id)), "every id of the manuals occurs once");
    for command in commands {
        let mut payload = Vec::new();
        command.write_payload(&mut payload);
        assert_eq!(Command::parse(command.id(), &payload).unwrap(), command);
    }
}

#[test]
fn wrong_lengths_get_the_manuals_status() {
    let no_param = [0x07, 0x22, 0x31, 0x33, 0x35, 0x36, 0x38, 0x46, 0x50, 0x52, 0x53];
    for row in id::COMMANDS {
        let status = Command::parse(row.id, &[0; 300]).err().map(InvalidRequest::status);
        let expected = match row.id {
            // A tag of 300 NULs is empty, thus valid.
            id::FAST_STOP | id::SET_DEVICE_TAG => None,
            id if no_param.contains(&id) => Some(Status::E_NO_PARAM_EXPECTED),
            _ => Some(Status::E_CMD_FORMAT_ERROR),
        };
        assert_eq!(status, expected, "{}", row.name);
    }
    assert_eq!(Command::parse(0x51, &[b'x'; 65]).unwrap_err().status(), Status::E_OVERRUN);
    assert_eq!(Command::parse(0x51, b"\n").unwrap_err().status(), Status::E_INVALID_PARAMETER);
    assert_eq!(Command::parse(0x20, &[3]).unwrap_err().status(), Status::E_INVALID_PARAMETER);
    assert_eq!(Command::parse(0x24, b"nak").unwrap_err().status(), Status::E_CMD_FORMAT_ERROR);
    assert_eq!(Command::parse(0x06, &[0; 257]).unwrap_err().status(), Status::E_CMD_FORMAT_ERROR);
    assert!(Command::parse(0x06, &[0; 256]).is_ok());
}

#[test]
fn non_finite_number_is_invalid_parameter() {
    let nan = [f32::NAN.to_le_bytes(), 50f32.to_le_bytes()].concat();
    assert_eq!(Command::parse(0x25, &nan).unwrap_err().status(), Status::E_INVALID_PARAMETER);
}

#[test]
fn fast_stop_takes_any_payload() {
    assert_eq!(Command::parse(0x23, &[1, 2, 3]).unwrap(), Command::FastStop);
}

#[test]
fn ruling_finger_power_has_its_parameter_at_byte_0() {
    let on = Command::FingerPower { finger: Finger::One, on: true };
    assert_eq!(Command::parse(0x62, &[1]).unwrap(), on);
    assert!(Command::parse(0x62, &[0, 1]).is_err());
}

#[test]
fn custom_command_requires_unlisted_id() {
    assert!(CustomCommand::new(0xB0, vec![]).is_some());
    assert!(CustomCommand::new(0x25, vec![]).is_none());
    assert!(CustomCommand::new(0xAA, vec![]).is_none());
    assert!(CustomCommand::new(0xB0, vec![0; 4097]).is_none());
}

#[test]
fn verbatim_command_keeps_its_bytes_and_counts_as_a_change() {
    let command = |id, bytes: &[u8]| Command::Verbatim(VerbatimCommand::new(id, bytes.to_vec()).unwrap());
    let (wrong, power) = (command(0x30, &[1]), command(0x62, &[1]));
    let mut bytes = Vec::new();
    wrong.write_payload(&mut bytes);
    assert_eq!((wrong.id(), &*bytes, wrong.is_read(), wrong.typed()), (0x30, &[1][..], false, None));
    assert!(!command(0x31, &[]).is_read(), "another client's lease protects against all such requests");
    assert!(power.is_two_step() && !wrong.is_two_step());
    assert!(VerbatimCommand::new(0xB0, vec![]).is_none() && VerbatimCommand::new(0x06, vec![0; 4097]).is_none());
}

/// Golden bytes of a grip at 20 mm and 50 mm/s. Do not change them.
#[test]
fn golden_grip() {
    let mut out = Vec::new();
    Command::Grip { width: width(20.0), speed: speed(50.0) }.encode(&mut out);
    assert_eq!(hex::encode_upper(&out[..14]), "AAAAAA2508000000A04100004842");
    assert_eq!(super::super::crc::checksum(&out), 0);
    assert_eq!(out.len(), 16, "a grip is exactly two CAN frames");
}
