//! The checksum of a frame (`fw4-en` Appendix D).
//!
//! A table-driven CRC-16 with polynomial 1021h. The table is built most significant bit first but consumed least
//! significant byte first. No CRC library can express the combination, because no catalogued CRC-16 uses it.
//!
//! Ruling: the table is built from the polynomial, because every printed table is damaged.

const POLYNOMIAL: u16 = 0x1021;

/// Initial value of a checksum (`fw4-en` Appendix D).
pub const INITIAL: u16 = 0xFFFF;

const TABLE: [u16; 256] = table();

const fn table() -> [u16; 256] {
    let mut table = [0u16; 256];
    let mut index = 0;
    while index < 256 {
        let mut value = (index as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            value = if value & 0x8000 == 0 { value << 1 } else { (value << 1) ^ POLYNOMIAL };
            bit += 1;
        }
        table[index] = value;
        index += 1;
    }
    table
}

/// Continues the checksum `crc` over `bytes`. The result over a whole frame including its checksum is 0.
#[must_use]
pub fn update(crc: u16, bytes: &[u8]) -> u16 {
    bytes.iter().fold(crc, |crc, &byte| TABLE[usize::from((crc ^ u16::from(byte)) as u8)] ^ (crc >> 8))
}

/// Checksum of `bytes`, starting at [`INITIAL`].
#[must_use]
pub fn checksum(bytes: &[u8]) -> u16 {
    update(INITIAL, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ruling_table_is_built_from_the_polynomial() {
        assert_eq!(TABLE[0], 0x0000);
        assert_eq!(TABLE[120], 0xff9f, "fw2 prints fff9");
        assert_eq!(TABLE[104], 0xedae, "fw4-de ends this one in a Cyrillic letter");
        assert_eq!(TABLE[89], 0xcbdc, "fw4-en prints cdbc");
        assert_eq!(TABLE[131], 0xa1eb, "fw2 and fw4-de print aleb");
        assert_eq!(TABLE[255], 0x1ef0);
    }

    #[test]
    fn checksum_of_the_shortest_printed_frame() {
        assert_eq!(checksum(&[0xAA, 0xAA, 0xAA, 0x01, 0x00, 0x00]), 0x10E8);
    }
}
