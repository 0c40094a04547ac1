//! Reader for the little-endian fields of a payload whose length was already checked.

use super::quantity::{NotFinite, Speed, Width};

/// Unread rest of a payload. Reads past the end return zeros: callers first check the length against the table in
/// [`id`](super::id).
#[derive(Debug, Clone, Copy)]
pub(super) struct PayloadReader<'a>(&'a [u8]);

impl<'a> PayloadReader<'a> {
    pub fn new(payload: &'a [u8]) -> Self {
        Self(payload)
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        match self.0.split_first_chunk() {
            Some((field, rest)) => {
                self.0 = rest;
                *field
            }
            None => [0; N],
        }
    }

    pub fn u8(&mut self) -> u8 {
        u8::from_le_bytes(self.take())
    }

    pub fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }

    pub fn i16(&mut self) -> i16 {
        i16::from_le_bytes(self.take())
    }

    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    pub fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.take())
    }

    pub fn width_and_speed(&mut self) -> Result<(Width, Speed), NotFinite> {
        Ok((Width::new(self.f32())?, Speed::new(self.f32())?))
    }

    pub fn rest(self) -> &'a [u8] {
        self.0
    }
}
