//! Layout of the registers.

/// Unit identifiers of the gateway itself.
pub(super) const GATEWAY_UNITS: [u8; 2] = [255, 0];

/// Address of input register 0 among the holding registers, where function code 23 reads it.
pub(super) const INPUTS_AT: u16 = 1000;

/// Address of the first register of the gateway map. The fieldbus map begins at 0.
const GATEWAY_MAP_AT: u16 = 100;

/// The register that requests a FAST STOP, also at the gateway's unit.
pub(super) const FAST_STOP_AT: u16 = 110;

/// Registers that have to be written as 0 once, before their map executes anything.
pub(super) const FLAGS_AT: u16 = 0;
pub(super) const COMMAND_AT: u16 = 101;

/// Value of a register whose value is unknown.
const UNKNOWN: u16 = 0x8000;

/// Registers of both maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Registers<const F: usize, const G: usize> {
    pub fieldbus: [u16; F],
    pub gateway: [u16; G],
}

/// Registers that a client writes.
pub(super) type Outputs = Registers<4, 11>;

/// Registers that a client reads.
pub(super) type Inputs = Registers<6, 32>;

impl<const F: usize, const G: usize> Registers<F, G> {
    pub(super) const ZERO: Self = Self { fieldbus: [0; F], gateway: [0; G] };

    pub(super) fn get(&self, address: u16) -> Option<u16> {
        match address.checked_sub(GATEWAY_MAP_AT) {
            Some(index) => self.gateway.get(usize::from(index)).copied(),
            None => self.fieldbus.get(usize::from(address)).copied(),
        }
    }

    /// Writes registers of one map. Returns `None`, and writes nothing, if one of them does not exist.
    pub(super) fn set(&mut self, address: u16, words: &[u16]) -> Option<()> {
        let (map, first) = match address.checked_sub(GATEWAY_MAP_AT) {
            Some(index) => (&mut self.gateway[..], index),
            None => (&mut self.fieldbus[..], address),
        };
        let first = usize::from(first);
        map.get_mut(first..first + words.len())?.copy_from_slice(words);
        Some(())
    }
}

/// All registers of a unit.
#[derive(Debug)]
pub(super) struct UnitRegisters {
    pub outputs: Outputs,
    pub inputs: Inputs,
    /// Number of the FAST STOP that the input registers show; 0 for none.
    pub seen: u16,
}

impl UnitRegisters {
    pub(super) const ZERO: Self = Self { outputs: Outputs::ZERO, inputs: Inputs::ZERO, seen: 0 };

    /// Reads input registers. Returns `None` if one of them does not exist.
    pub(super) fn inputs(&self, address: u16, count: u16) -> Option<Vec<u16>> {
        read(address, count, |address| self.inputs.get(address))
    }

    /// Reads holding registers: the client's values, and the copies of the input registers.
    pub(super) fn holding(&self, address: u16, count: u16) -> Option<Vec<u16>> {
        read(address, count, |address| match address.checked_sub(INPUTS_AT) {
            Some(address) => self.inputs.get(address),
            None => self.outputs.get(address),
        })
    }
}

fn read(address: u16, count: u16, get: impl Fn(u16) -> Option<u16>) -> Option<Vec<u16>> {
    let end = address.checked_add(count)?;
    (address..end).map(get).collect()
}

/// Returns a measured value as a signed register with this many steps per unit.
pub(super) fn scaled(value: Option<f32>, steps: f32) -> u16 {
    let Some(value) = value.filter(|value| value.is_finite()) else { return UNKNOWN };
    let limit = f32::from(i16::MAX);
    // The value fits after the clamp, and -32768 stays free for unknown values.
    ((value * steps).round().clamp(-limit, limit) as i16).cast_unsigned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_rounded_and_limited() {
        assert_eq!(scaled(Some(19.996), 100.0), 2000);
        assert_eq!(scaled(Some(-1.5), 100.0), (-150_i16).cast_unsigned());
        assert_eq!(scaled(Some(400.0), 100.0), 32_767);
        assert_eq!(scaled(Some(-400.0), 100.0), (-32_767_i16).cast_unsigned());
        assert_eq!((scaled(None, 10.0), scaled(Some(f32::NAN), 10.0)), (UNKNOWN, UNKNOWN));
    }

    #[test]
    fn registers_outside_the_maps_do_not_exist() {
        let mut outputs = Outputs::ZERO;
        assert_eq!(outputs.set(0, &[1, 2, 3, 4]), Some(()));
        assert_eq!(outputs.set(109, &[5, 6]), Some(()));
        for (address, count) in [(0, 5), (4, 1), (99, 2), (110, 2), (111, 1), (1000, 1), (65_535, 2)] {
            assert_eq!(outputs.set(address, &vec![9; count]), None, "{address}");
        }
        let unit = UnitRegisters { outputs, inputs: Inputs { fieldbus: [7; 6], gateway: [8; 32] }, seen: 0 };
        assert_eq!(unit.holding(0, 4), Some(vec![1, 2, 3, 4]));
        assert_eq!(unit.holding(108, 3), Some(vec![0, 5, 6]));
        assert_eq!((unit.inputs(0, 6), unit.holding(1000, 6)), (Some(vec![7; 6]), Some(vec![7; 6])));
        assert_eq!((unit.inputs(100, 32), unit.holding(1100, 32)), (Some(vec![8; 32]), Some(vec![8; 32])));
        for (address, count) in [(5, 2), (6, 1), (99, 1), (131, 2), (65_535, 1)] {
            assert_eq!(
                (unit.inputs(address, count), unit.holding(1000_u16.saturating_add(address), count)),
                (None, None)
            );
        }
    }
}
