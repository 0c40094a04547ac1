use super::super::command::tests::every_command;
use super::super::{Frame, Status, SystemState};
use super::*;

#[test]
fn every_command_survives_a_round_trip() {
    for command in every_command() {
        let text = command.to_string();
        assert_eq!(text.parse::<Command>().as_ref(), Ok(&command), "{text}");
    }
}

#[test]
fn grip_parses_from_text() {
    let command: Command = "Grip width=20 speed=50".parse().unwrap();
    assert_eq!(command.to_string(), "Grip width=20 speed=50");
    assert_eq!("FastStop".parse::<Command>().unwrap(), Command::FastStop);
    assert_eq!("faststop".parse::<Command>().unwrap(), Command::FastStop);
}

#[test]
fn custom_command_uses_command_editor_syntax() {
    let command: Command = "0xB0 0x20 7 150.0f \"a b\"".parse().unwrap();
    let Command::Custom(custom) = command else { panic!("{command:?}") };
    assert_eq!(custom.payload(), [&[0x20, 7][..], &150f32.to_le_bytes(), b"a b"].concat());
}

#[test]
fn errors_name_the_mistake() {
    let mistake = |text: &str| text.parse::<Command>().unwrap_err().to_string();
    assert!(mistake("Grap width=20").contains("\"Grap\""));
    assert!(mistake("").contains("unknown command"));
    assert!(mistake("Grip width=20").contains("needs speed"));
    assert!(mistake("Grip width=20 speed=fast").contains("speed=fast"));
    assert!(mistake("Grip width=NaN speed=50").contains("finite"));
    assert!(mistake("Grip width=20 speed=50 force=3").contains("no field \"force\""));
    assert!(mistake("Stop now").contains("\"now\""));
    assert!(mistake("0xB0 256").contains("256"));
    assert!(mistake("0x25 1").contains("payload"));
    assert!(mistake("SetSoftLimits minus=9 plus=5").contains("at most plus"));
}

#[test]
fn describe_covers_possible_readings() {
    let describe = |id, payload: &[u8]| describe(Frame { id, payload }, WireDirection::Unknown);
    assert_eq!(describe(0x22, &[]), "Stop");
    assert_eq!(describe(0x20, &[0, 0]), "Homing -> E_SUCCESS");
    assert_eq!(describe(0x21, &[0x1A, 0]), "PrePosition -> E_CMD_PENDING");
    let flags = Reply::Success(Data::SystemState(SystemState::REFERENCED | SystemState::FAST_STOP));
    assert_eq!(flags.to_string(), "E_SUCCESS flags=0x00001001 REFERENCED,FAST_STOP");
    assert_eq!(Reply::Status(Status::from_code(99)).to_string(), "E_99");
    assert!(describe(0x41, &[0, 0, 4]).contains("or its reply: E_SUCCESS state=4 HOLDING"));
    assert_eq!(describe(0xB0, &[0, 0, 1]), "0xB0 -> E_SUCCESS data=01");
    assert!(describe(0x25, &[1]).contains("invalid payload for this id"));
}
