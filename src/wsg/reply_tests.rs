use super::*;

fn width(mm: f32) -> Width {
    Width::new(mm).unwrap()
}

fn round_trip(id: u8, data: Data) {
    let mut bytes = Vec::new();
    let reply = Reply::Success(data);
    reply.encode(id, &mut bytes);
    let payload = &bytes[frame::HEADER_BYTES..bytes.len() - 2];
    assert!(payload.len() <= id::max_reply_bytes(id));
    assert_eq!(Reply::parse(id, payload).unwrap(), reply);
}

#[test]
fn every_reply_survives_a_round_trip() {
    let force = |n| Force::new(n).unwrap();
    let speed = |mm_s| Speed::new(mm_s).unwrap();
    let acceleration = |mm_s2| Acceleration::new(mm_s2).unwrap();
    round_trip(0x06, Data::Loop(vec![0xAA; 256]));
    round_trip(0x20, Data::None);
    round_trip(0x31, Data::Acceleration(acceleration(150.0)));
    round_trip(0x33, Data::ForceLimit(force(40.0)));
    round_trip(0x35, Data::SoftLimits(SoftLimits::new(width(5.0), width(90.0)).unwrap()));
    round_trip(0x40, Data::SystemState(SystemState::from_bits_retain(0x8000_1401)));
    round_trip(0x41, Data::GripperState(GripperState::Holding));
    round_trip(0x42, Data::Statistics(Statistics { total: 70_000, no_part: 3, lost_part: 2 }));
    round_trip(0x43, Data::Width(width(-0.02)));
    round_trip(0x44, Data::Speed(speed(-12.5)));
    round_trip(0x45, Data::Force(force(39.9)));
    round_trip(0x46, Data::Temperature(Temperature(-11)));
    round_trip(
        0x50,
        Data::SystemInfo(SystemInfo {
            device_type: DeviceType::Wsg70,
            hardware_revision: 6,
            firmware: Firmware(0x4020),
            serial_number: 4711,
        }),
    );
    round_trip(0x52, Data::DeviceTag(DeviceTag::new(b"cell 7").unwrap()));
    round_trip(0x52, Data::DeviceTag(DeviceTag::reported(b"Zelle \xFC\0").unwrap()));
    round_trip(
        0x53,
        Data::SystemLimits(SystemLimits {
            stroke: width(110.0),
            min_speed: speed(5.0),
            max_speed: speed(420.0),
            min_acceleration: acceleration(100.0),
            max_acceleration: acceleration(5000.0),
            min_force: force(5.0),
            nominal_force: force(80.0),
            overdrive_force: force(120.0),
        }),
    );
    for (finger, base) in [(Finger::One, 0x60), (Finger::Two, 0x70)] {
        round_trip(base, Data::FingerInfo(finger, FingerInfo { finger_type: FingerType::Dsa, data_bytes: 84 }));
        round_trip(base + 1, Data::FingerFlags(finger, FingerFlags::POWER_ON | FingerFlags::COMM_FAULT));
        round_trip(base + 3, Data::FingerData(finger, vec![1, 2, 3]));
    }
    round_trip(0xB0, Data::Custom(vec![9; 30]));
}

#[test]
fn ruling_get_acceleration_answers_with_its_own_id() {
    let payload = [0, 0, 0, 0, 0x16, 0x43];
    let expected = Reply::Success(Data::Acceleration(Acceleration::new(150.0).unwrap()));
    assert_eq!(Reply::parse(0x31, &payload).unwrap(), expected);
    assert!(Reply::parse(0x30, &payload).is_err(), "Set Acceleration returns no parameters");
}

#[test]
fn ruling_loop_data_come_with_success() {
    assert_eq!(Reply::parse(0x06, &[0, 0, 7]).unwrap(), Reply::Success(Data::Loop(vec![7])));
}

#[test]
#[allow(clippy::float_cmp, reason = "the only computation is a division by ten")]
fn ruling_fff5h_is_minus_1_1_degrees() {
    let celsius = |bytes: [u8; 2]| match Reply::parse(0x46, &[0, 0, bytes[0], bytes[1]]) {
        Ok(Reply::Success(Data::Temperature(temperature))) => temperature.celsius(),
        other => panic!("{other:?}"),
    };
    assert_eq!(celsius([0xF5, 0xFF]), -1.1);
    assert_eq!(celsius([0xF6, 0xFF]), -1.0);
    assert_eq!(celsius([0xF4, 0x01]), 50.0);
}

#[test]
fn ruling_finger_size_is_at_bytes_1_and_2_of_3_or_2_and_3_of_4() {
    let size = |payload: &[u8]| match Reply::parse(0x60, payload) {
        Ok(Reply::Success(Data::FingerInfo(_, info))) => info.data_bytes,
        other => panic!("{other:?}"),
    };
    assert_eq!(size(&[0, 0, 2, 84, 0]), 84);
    assert_eq!(size(&[0, 0, 2, 0, 84, 0]), 84);
}

#[test]
fn impossible_replies_are_rejected() {
    assert!(Reply::parse(0x40, &[0]).is_err(), "no room for a status");
    assert!(Reply::parse(0x40, &[0, 0, 1]).is_err(), "flags are four bytes");
    assert!(Reply::parse(0x40, &[16, 0, 1]).is_err(), "an error has no data");
    assert!(Reply::parse(0x43, &[0, 0, 0, 0, 0xC0, 0x7F]).is_err(), "NaN is not a width");
    assert!(Reply::parse(0x52, &[0, 0, 7]).is_err(), "a tag has no control characters");
    assert_eq!(Reply::parse(0x40, &[0x67, 0x12]).unwrap(), Reply::Status(Status::from_code(0x1267)));
}

#[test]
fn fields_behind_the_known_ones_are_ignored() {
    let mut payload = vec![0, 0, 3, 1, 0x20, 0x40, 0x67, 0x12, 0, 0];
    let known = Reply::parse(0x50, &payload).unwrap();
    payload.extend([9; 64]);
    assert_eq!(Reply::parse(0x50, &payload).unwrap(), known);
    payload.push(9);
    assert!(Reply::parse(0x50, &payload).is_err(), "longer than any added fields");
    assert!(Reply::parse(0x50, &payload[..9]).is_err(), "a missing field");
}
