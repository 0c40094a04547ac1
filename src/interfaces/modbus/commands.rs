//! Commands of the gateway map.

use serde_json::{Map, Value, json};

use super::order::{ModbusOrder, OutOfRange};
use crate::operations::gripper::motion;

/// Holding registers of the gateway map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct CommandRegisters {
    /// A change executes the command.
    pub counter: u16,
    pub command: u16,
    /// Number of the recipe; 0 for none.
    recipe: u16,
    /// In 1/100 mm.
    width: i16,
    /// In 1/10 mm/s.
    speed: u16,
    /// In 1/10 N.
    force: u16,
    options: u16,
    on_loss: u16,
    pub heartbeat: u16,
    fast_stop_number: u16,
    pub fast_stop: u16,
}

impl From<[u16; 11]> for CommandRegisters {
    fn from(registers: [u16; 11]) -> Self {
        let [counter, command, recipe, width, speed, force, options, on_loss, heartbeat, fast_stop_number, fast_stop] =
            registers;
        let width = width.cast_signed();
        Self { counter, command, recipe, width, speed, force, options, on_loss, heartbeat, fast_stop_number, fast_stop }
    }
}

/// Bits of `options`.
const RELATIVE: u16 = 1;
const CLAMP: u16 = 1 << 1;
const OVERRIDE_RECIPE: u16 = 1 << 2;
/// Position of the direction of homing.
const DIRECTION: u16 = 4;
/// Bits without a meaning.
const UNDEFINED: u16 = !(RELATIVE | CLAMP | OVERRIDE_RECIPE | 3 << DIRECTION);

impl CommandRegisters {
    /// Returns the order of the command, or `None` for command 0.
    ///
    /// # Errors
    /// [`OutOfRange`] if the map does not define a value. The operations check the values themselves.
    pub(super) fn order(&self) -> Result<Option<ModbusOrder>, OutOfRange> {
        if self.command != 0 && self.options & UNDEFINED != 0 {
            return Err(OutOfRange);
        }
        Ok(Some(match self.command {
            0 => return Ok(None),
            1 => ModbusOrder::motion(&motion::HOME, json!({"direction": self.direction()?})),
            2 => ModbusOrder::motion(&motion::MOVE, self.movement()),
            3 => ModbusOrder::motion(&motion::GRIP, self.values(true)?),
            4 => ModbusOrder::motion(&motion::RELEASE, self.values(false)?),
            5 => ModbusOrder::Stop,
            6 => ModbusOrder::Acknowledge { number: self.fast_stop_number },
            7 => ModbusOrder::TakeLease(self.terms()?),
            8 => ModbusOrder::ReleaseLease,
            _ => return Err(OutOfRange),
        }))
    }

    fn direction(&self) -> Result<&'static str, OutOfRange> {
        match self.options >> DIRECTION & 3 {
            0 => Ok("default"),
            1 => Ok("outer"),
            2 => Ok("inner"),
            _ => Err(OutOfRange),
        }
    }

    fn movement(&self) -> Value {
        json!({
            "width_mm": self.width_mm(),
            "speed_mm_s": tenths(self.speed),
            "relative": self.options & RELATIVE != 0,
            "on_block": if self.options & CLAMP != 0 { "clamp" } else { "stop" },
        })
    }

    /// Values of a grip or of a release: of the registers, of the recipe, or of both.
    fn values(&self, has_force: bool) -> Result<Value, OutOfRange> {
        let recipe = u8::try_from(self.recipe).map_err(|_| OutOfRange)?;
        let uses_recipe = recipe != 0;
        let overrides = self.options & OVERRIDE_RECIPE != 0;
        // Beside a recipe, 0 leaves the recipe's value as it is.
        let has_width = !uses_recipe || (overrides && self.width != 0);
        let has_speed = !uses_recipe || (overrides && self.speed != 0);
        let has_force = has_force && self.force != 0 && (!uses_recipe || overrides);
        let given = [
            ("recipe", uses_recipe, json!(recipe)),
            ("width_mm", has_width, json!(self.width_mm())),
            ("speed_mm_s", has_speed, json!(tenths(self.speed))),
            ("force_n", has_force, json!(tenths(self.force))),
        ];
        let fields = given.into_iter().filter(|(_, is_given, _)| *is_given);
        Ok(Value::Object(fields.map(|(name, _, value)| (name.to_owned(), value)).collect()))
    }

    fn terms(&self) -> Result<Value, OutOfRange> {
        let moving = [None, Some("fast_stop"), Some("stop"), Some("finish")];
        let holding = [None, Some("keep"), Some("fast_stop")];
        let moving = *moving.get(usize::from(self.on_loss & 15)).ok_or(OutOfRange)?;
        let holding = *holding.get(usize::from(self.on_loss >> 4)).ok_or(OutOfRange)?;
        let terms = [("on_loss_moving", moving), ("on_loss_holding", holding)];
        let given = terms.into_iter().filter_map(|(name, term)| Some((name.to_owned(), term?.into())));
        Ok(Value::Object(given.collect::<Map<_, _>>()))
    }

    fn width_mm(&self) -> f64 {
        f64::from(self.width) / 100.0
    }
}

fn tenths(register: u16) -> f64 {
    f64::from(register) / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(
        command: u16,
        recipe: u16,
        values: [u16; 3],
        options: u16,
        on_loss: u16,
    ) -> Result<Option<ModbusOrder>, OutOfRange> {
        let [width, speed, force] = values;
        CommandRegisters::from([1, command, recipe, width, speed, force, options, on_loss, 0, 42, 0]).order()
    }

    #[test]
    fn registers_become_parameters() {
        let values = [4050, 1005, 405];
        assert_eq!(order(0, 0, values, 0, 0), Ok(None));
        assert_eq!(
            order(1, 0, values, 0x10, 0),
            Ok(Some(ModbusOrder::motion(&motion::HOME, json!({"direction": "outer"}))))
        );
        let relative = json!({"width_mm": -0.5, "speed_mm_s": 100.5, "relative": true, "on_block": "clamp"});
        assert_eq!(
            order(2, 0, [(-50_i16).cast_unsigned(), 1005, 0], 3, 0),
            Ok(Some(ModbusOrder::motion(&motion::MOVE, relative)))
        );
        let grip = json!({"width_mm": 40.5, "speed_mm_s": 100.5, "force_n": 40.5});
        assert_eq!(order(3, 0, values, 0, 0), Ok(Some(ModbusOrder::motion(&motion::GRIP, grip))));
        assert_eq!(
            order(4, 0, values, 0, 0),
            Ok(Some(ModbusOrder::motion(&motion::RELEASE, json!({"width_mm": 40.5, "speed_mm_s": 100.5}))))
        );
        assert_eq!(order(5, 0, values, 0, 0), Ok(Some(ModbusOrder::Stop)));
        assert_eq!(order(6, 0, values, 0, 0), Ok(Some(ModbusOrder::Acknowledge { number: 42 })));
        assert_eq!(order(8, 0, values, 0, 0), Ok(Some(ModbusOrder::ReleaseLease)));
    }

    #[test]
    fn recipe_has_all_values_unless_it_is_overridden() {
        let values = [4050, 0, 405];
        assert_eq!(order(3, 12, values, 0, 0), Ok(Some(ModbusOrder::motion(&motion::GRIP, json!({"recipe": 12})))));
        let overridden = json!({"recipe": 12, "width_mm": 40.5, "force_n": 40.5});
        assert_eq!(order(3, 12, values, OVERRIDE_RECIPE, 0), Ok(Some(ModbusOrder::motion(&motion::GRIP, overridden))));
        let released = json!({"recipe": 12, "width_mm": 40.5});
        assert_eq!(order(4, 12, values, OVERRIDE_RECIPE, 0), Ok(Some(ModbusOrder::motion(&motion::RELEASE, released))));
    }

    #[test]
    fn terms_of_the_lease() {
        let terms = |on_loss| order(7, 0, [0; 3], 0, on_loss);
        assert_eq!(terms(0), Ok(Some(ModbusOrder::TakeLease(json!({})))));
        let both = json!({"on_loss_moving": "finish", "on_loss_holding": "fast_stop"});
        assert_eq!(terms(0x23), Ok(Some(ModbusOrder::TakeLease(both))));
        assert_eq!((terms(4), terms(0x30)), (Err(OutOfRange), Err(OutOfRange)));
    }

    #[test]
    fn values_without_a_meaning_are_refused() {
        assert_eq!(order(9, 0, [0; 3], 0, 0), Err(OutOfRange));
        assert_eq!(order(3, 256, [0; 3], 0, 0), Err(OutOfRange));
        assert_eq!(order(1, 0, [0; 3], 0x30, 0), Err(OutOfRange));
        assert_eq!(order(5, 0, [0; 3], 0x40, 0), Err(OutOfRange));
    }
}
