//! Options of a simulated device, as in the query of a `sim://` URL.

use std::ops::RangeInclusive;
use std::str::FromStr;
use std::time::Duration;

use super::{
    AxisDirection, BadChecksum, DeviceConfig, FingerConfig, GripSide, Part, Script, ScriptAnswer, SteeringScript,
};
use wsg::{ChecksumEvaluation, DeviceTag, SoftLimits, Status, Width, id};

/// Allowed values of a width.
const WITHIN_STROKE: &str = "a width within the stroke";

/// All options with their allowed values, as listed in the guide.
const OPTIONS: [(&str, &str); 38] = [
    ("part_mm", WITHIN_STROKE),
    ("part_side", "outside or inside"),
    ("part_stiffness_n_mm", "0.1 to 2000"),
    ("firmware", "fw2 or fw4"),
    ("serial_number", "a whole number"),
    ("start_width_mm", WITHIN_STROKE),
    ("homing", "outer or inner"),
    ("clamping_travel_mm", "0 to 20"),
    ("part_width_tolerance_mm", "0 to 20"),
    ("acceleration_mm_s2", "a value within the limits"),
    ("force_limit_n", "a force up to nominal"),
    ("soft_limits_mm", "the limits as MINUS..PLUS, e.g. 10..60"),
    ("device_tag", "up to 64 printable characters of ISO 8859-1"),
    ("checksum_evaluation", "true or false"),
    ("bad_checksum", "silence or answer"),
    ("fast_stop_on_disconnect", "true or false"),
    ("finger1", "none, generic, fmf, or dsa: with its data as hex"),
    ("finger2", "none, generic, fmf, or dsa: with its data as hex"),
    ("force_sensor", "true or false"),
    ("force_sensor_offset_n", "-100 to 100"),
    ("overdrive", "true or false"),
    ("script", "ID:echo, ID:measurement, ID:data:HEX or ID:status:CODE, e.g. B0:measurement"),
    ("steering", "pd, width or watchdog"),
    ("steering_period_ms", "1 to 1000"),
    ("steering_delay_ms", "0 to 1000"),
    ("width_before_referencing", "true or false"),
    ("answers_update_requests", "true or false"),
    ("loop_is_pending", "true or false"),
    ("stop_answers_first", "true or false"),
    ("stop_sets_flag_when_idle", "true or false"),
    ("stop_lets_go", "true or false"),
    ("fast_stop_lets_go", "true or false"),
    ("early_acknowledge", "a status code, 0 to 65535"),
    ("opposite_grip", "a status code, 0 to 65535"),
    ("ambient_c", "-40 to 200"),
    ("warning_c", "-40 to 200"),
    ("critical_c", "-40 to 200"),
    ("partial_request_timeout_ms", "1 to 60000"),
];

impl DeviceConfig {
    /// Sets an option.
    ///
    /// # Errors
    /// The option with its allowed values, or all options.
    pub fn set(&mut self, option: &str, value: &str) -> Result<(), String> {
        let Some((_, allowed)) = OPTIONS.iter().find(|(name, _)| *name == option) else {
            let names: Vec<_> = OPTIONS.iter().map(|(name, _)| *name).collect();
            return Err(format!("unknown option {option}: use {}", names.join(", ")));
        };
        let stroke_mm = self.limits.stroke.mm();
        apply(self, option, value).ok_or_else(|| match *allowed {
            WITHIN_STROKE => format!("{option} is {value:?}; it must be a width from 0 to {stroke_mm}"),
            _ => format!("{option} is {value:?}; it must be {allowed}"),
        })
    }
}

/// Sets an option, or returns `None` if the value is not allowed.
fn apply(config: &mut DeviceConfig, option: &str, value: &str) -> Option<()> {
    let limits = config.limits;
    let stroke = 0.0..=f64::from(limits.stroke.mm());
    match option {
        "part_mm" => part(config).width_mm = within(value, stroke)?,
        "part_side" => {
            part(config).side = one_of(value, [("outside", GripSide::Outside), ("inside", GripSide::Inside)])?;
        }
        "part_stiffness_n_mm" => part(config).stiffness_n_mm = within(value, 0.1..=2000.0)?,
        "firmware" => *config = one_of(value, [("fw4", config.clone()), ("fw2", config.clone().fw2())])?,
        "serial_number" => config.serial_number = value.parse().ok()?,
        "start_width_mm" => config.start_width_mm = within(value, stroke)?,
        "homing" => {
            config.homing = one_of(value, [("outer", AxisDirection::Opening), ("inner", AxisDirection::Closing)])?;
        }
        "clamping_travel_mm" => config.clamping_travel_mm = within(value, 0.0..=20.0)?,
        "part_width_tolerance_mm" => config.part_width_tolerance_mm = within(value, 0.0..=20.0)?,
        "acceleration_mm_s2" => {
            let range = limits.min_acceleration.mm_s2().into()..=limits.max_acceleration.mm_s2().into();
            config.acceleration_mm_s2 = within(value, range)?;
        }
        "force_limit_n" => {
            config.force_limit_n = within(value, limits.min_force.n().into()..=limits.nominal_force.n().into())?;
        }
        "soft_limits_mm" => {
            let (minus, plus) = value.split_once("..")?;
            let minus = Width::new(within(minus, stroke.clone())? as f32).ok()?;
            let plus = Width::new(within(plus, stroke)? as f32).ok()?;
            config.soft_limits = Some(SoftLimits::new(minus, plus)?);
        }
        "device_tag" => {
            config.device_tag = Some(DeviceTag::from_text(value).ok()?).filter(|tag| !tag.is_empty());
        }
        "checksum_evaluation" => {
            let values = [("true", ChecksumEvaluation::On), ("false", ChecksumEvaluation::Off)];
            config.checksum_evaluation = one_of(value, values)?;
        }
        "bad_checksum" => {
            config.bad_checksum = one_of(value, [("silence", BadChecksum::Silence), ("answer", BadChecksum::Answer)])?;
        }
        "finger1" => config.fingers[0] = finger(value)?,
        "finger2" => config.fingers[1] = finger(value)?,
        "force_sensor_offset_n" => config.force_sensor_offset_n = within(value, -100.0..=100.0)?,
        "script" => config.scripts.push(script(value)?),
        "steering" => config.steering.script = Some(steering(value)?),
        "steering_period_ms" => config.steering.period = Duration::from_millis(within(value, 1..=1000)?),
        "steering_delay_ms" => config.steering.delay = Duration::from_millis(within(value, 0..=1000)?),
        "early_acknowledge" => config.early_acknowledge = Status::from_code(value.parse().ok()?),
        "opposite_grip" => config.opposite_grip = Status::from_code(value.parse().ok()?),
        "ambient_c" => config.ambient_c = within(value, -40.0..=200.0)?,
        "warning_c" => config.warning_c = within(value, -40.0..=200.0)?,
        "critical_c" => config.critical_c = within(value, -40.0..=200.0)?,
        "partial_request_timeout_ms" => {
            config.partial_request_timeout = Duration::from_millis(within(value, 1..=60_000)?);
        }
        _ => *switch(config, option)? = value.parse().ok()?,
    }
    Some(())
}

/// Field of an option whose value is true or false.
fn switch<'a>(config: &'a mut DeviceConfig, option: &str) -> Option<&'a mut bool> {
    Some(match option {
        "fast_stop_on_disconnect" => &mut config.fast_stop_on_disconnect,
        "force_sensor" => &mut config.force_sensor,
        "overdrive" => &mut config.overdrive,
        "width_before_referencing" => &mut config.width_before_referencing,
        "answers_update_requests" => &mut config.answers_update_requests,
        "loop_is_pending" => &mut config.loop_is_pending,
        "stop_answers_first" => &mut config.stop_answers_first,
        "stop_sets_flag_when_idle" => &mut config.stop_sets_flag_when_idle,
        "stop_lets_go" => &mut config.stop_lets_go,
        "fast_stop_lets_go" => &mut config.fast_stop_lets_go,
        _ => return None,
    })
}

/// The part within reach. Its width is 20 mm until an option sets it.
fn part(config: &mut DeviceConfig) -> &mut Part {
    config.part.get_or_insert(Part::outside(20.0))
}

fn within<T: FromStr + PartialOrd>(text: &str, range: RangeInclusive<T>) -> Option<T> {
    text.parse().ok().filter(|value| range.contains(value))
}

fn one_of<T, const N: usize>(text: &str, values: [(&str, T); N]) -> Option<T> {
    values.into_iter().find_map(|(name, value)| (name == text).then_some(value))
}

fn finger(text: &str) -> Option<FingerConfig> {
    match text.strip_prefix("dsa:") {
        Some(frame) => Some(FingerConfig::Dsa { frame: hex::decode(frame).ok()? }),
        None => {
            one_of(text, [("none", FingerConfig::None), ("generic", FingerConfig::Generic), ("fmf", FingerConfig::Fmf)])
        }
    }
}

fn steering(text: &str) -> Option<SteeringScript> {
    let scripts =
        [("pd", SteeringScript::Pd), ("width", SteeringScript::Width), ("watchdog", SteeringScript::Watchdog)];
    one_of(text, scripts)
}

fn script(text: &str) -> Option<Script> {
    let (id, answer) = text.split_once(':')?;
    let id = u8::from_str_radix(id, 16).ok().filter(|id| id::describe(*id).is_none())?;
    let answer = match answer.split_once(':') {
        None => one_of(answer, [("echo", ScriptAnswer::Echo), ("measurement", ScriptAnswer::Measurement)])?,
        Some(("data", bytes)) => ScriptAnswer::Bytes(hex::decode(bytes).ok()?),
        Some(("status", code)) => ScriptAnswer::Status(code.parse().ok()?),
        Some(_) => return None,
    };
    Some(Script { id, answer })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set_on_wsg50(option: &str, value: &str) -> Result<DeviceConfig, String> {
        let mut config = DeviceConfig::wsg50();
        config.set(option, value).map(|()| config)
    }

    /// A value of each option that differs from the default.
    const OTHERS: [(&str, &str); OPTIONS.len()] = [
        ("part_mm", "20"),
        ("part_side", "inside"),
        ("part_stiffness_n_mm", "3"),
        ("firmware", "fw2"),
        ("serial_number", "7"),
        ("start_width_mm", "1.5"),
        ("homing", "inner"),
        ("clamping_travel_mm", "2"),
        ("part_width_tolerance_mm", "2"),
        ("acceleration_mm_s2", "300"),
        ("force_limit_n", "10"),
        ("soft_limits_mm", "10..60"),
        ("device_tag", "cell 7"),
        ("checksum_evaluation", "false"),
        ("bad_checksum", "answer"),
        ("fast_stop_on_disconnect", "false"),
        ("finger1", "fmf"),
        ("finger2", "dsa:0102"),
        ("force_sensor", "true"),
        ("force_sensor_offset_n", "-1.5"),
        ("overdrive", "false"),
        ("script", "B0:status:14"),
        ("steering", "pd"),
        ("steering_period_ms", "10"),
        ("steering_delay_ms", "5"),
        ("width_before_referencing", "true"),
        ("answers_update_requests", "false"),
        ("loop_is_pending", "true"),
        ("stop_answers_first", "false"),
        ("stop_sets_flag_when_idle", "false"),
        ("stop_lets_go", "true"),
        ("fast_stop_lets_go", "false"),
        ("early_acknowledge", "18"),
        ("opposite_grip", "18"),
        ("ambient_c", "30"),
        ("warning_c", "50"),
        ("critical_c", "60"),
        ("partial_request_timeout_ms", "100"),
    ];

    #[test]
    fn every_option_changes_the_configuration_and_is_in_the_guide() {
        let before = format!("{:?}", DeviceConfig::wsg50());
        let guide = include_str!("../../deploy/guide/simulator.md");
        for ((option, value), (name, _)) in OTHERS.into_iter().zip(OPTIONS) {
            assert_eq!(option, name);
            let config = set_on_wsg50(option, value).unwrap();
            assert_ne!(format!("{config:?}"), before, "{option}");
            let wrong = set_on_wsg50(option, "?").err();
            assert!(option == "device_tag" || wrong.unwrap().contains("it must be"), "{option}");
            assert!(guide.contains(&format!("| `{option}` |")), "{option} is not in the guide");
        }
    }

    #[test]
    fn values_beyond_the_limits_are_refused() {
        for (option, value) in [
            ("part_mm", "110.5"),
            ("part_mm", "NaN"),
            ("soft_limits_mm", "60..10"),
            ("force_limit_n", "81"),
            ("script", "25:echo"),
            ("finger1", "dsa:1"),
            ("colour", "red"),
        ] {
            assert!(set_on_wsg50(option, value).is_err(), "{option}={value}");
        }
    }
}
