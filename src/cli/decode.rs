//! `wsg-gateway decode`: hex to readable frames, one line a frame, and back.
//!
//! A line of input is hex, with what may stand before it: a time, and `>` (to the device) or `<` (from it). Frames may
//! go on from one line to the next of the same direction.

use std::io::{BufRead, Write};

use anyhow::Context;

use crate::wsg::text::{Direction, describe};
use crate::wsg::{ChecksumEvaluation, Command, Decoded, Decoder, id};

/// The bytes of the frame that a text describes, as hex.
///
/// # Errors
/// What is wrong with the text.
pub(super) fn encode(text: &str) -> anyhow::Result<String> {
    let command: Command = text.parse()?;
    let mut frame = Vec::new();
    command.encode(&mut frame);
    let bytes: Vec<_> = frame.iter().map(|byte| format!("{byte:02X}")).collect();
    Ok(bytes.join(" "))
}

/// Reads lines of hex, and writes a line a frame.
///
/// # Errors
/// A line that has no hex, by its number; or what the operating system says.
pub(super) fn decode(input: impl BufRead, output: &mut impl Write) -> anyhow::Result<()> {
    let mut streams = [Direction::Request, Direction::Reply, Direction::Unknown].map(Stream::new);
    for (index, line) in input.lines().enumerate() {
        let line = line?;
        let Some(line) = Line::parse(&line).with_context(|| format!("line {}", index + 1))? else { continue };
        for stream in &mut streams {
            if stream.direction == line.direction {
                stream.take(&line, output)?;
            }
        }
    }
    for stream in &streams {
        if stream.decoder.is_partial() {
            writeln!(output, "{}a frame cut short at the end", stream.mark())?;
        }
    }
    Ok(())
}

/// A line of input.
struct Line<'a> {
    time: &'a str,
    direction: Direction,
    bytes: Vec<u8>,
}

impl<'a> Line<'a> {
    /// `None` for an empty line.
    fn parse(text: &'a str) -> anyhow::Result<Option<Self>> {
        let text = text.trim();
        if text.is_empty() {
            return Ok(None);
        }
        let (time, direction, digits) = if let Some(at) = text.find(['>', '<']) {
            let direction = if text[at..].starts_with('>') { Direction::Request } else { Direction::Reply };
            (text[..at].trim(), direction, &text[at + 1..])
        } else {
            // What is no hex at the beginning is a time.
            let starts = text.split_whitespace().find(|word| bytes(word).is_ok());
            let at = starts.map_or(0, |word| word.as_ptr() as usize - text.as_ptr() as usize);
            (text[..at].trim(), Direction::Unknown, &text[at..])
        };
        let words = digits.split(|character: char| character.is_whitespace() || character == ',');
        let parsed: anyhow::Result<Vec<Vec<u8>>> = words.filter(|word| !word.is_empty()).map(bytes).collect();
        Ok(Some(Self { time, direction, bytes: parsed?.concat() }))
    }
}

/// Bytes as `AA`, `AAh`, `0xAA` or `AAAAAA25`.
fn bytes(word: &str) -> anyhow::Result<Vec<u8>> {
    let digits = word.trim_start_matches("0x").trim_end_matches(['h', 'H']);
    hex::decode(digits).with_context(|| format!("{word:?} is no hex: write bytes as AA AA AA 22 00 00 0E 76"))
}

/// What goes one way.
struct Stream {
    direction: Direction,
    decoder: Decoder,
    skipped: u64,
}

impl Stream {
    fn new(direction: Direction) -> Self {
        let decoder = Decoder::new(id::max_request_bytes, ChecksumEvaluation::On);
        Self { direction, decoder, skipped: 0 }
    }

    fn mark(&self) -> &'static str {
        match self.direction {
            Direction::Request => "> ",
            Direction::Reply => "< ",
            Direction::Unknown => "",
        }
    }

    fn take(&mut self, line: &Line<'_>, output: &mut impl Write) -> std::io::Result<()> {
        self.decoder.push(&line.bytes);
        let before = if line.time.is_empty() { String::new() } else { format!("{} ", line.time) };
        let mark = self.mark();
        while let Some(decoded) = self.decoder.next() {
            match decoded {
                Decoded::Frame(frame) => {
                    writeln!(output, "{before}{mark}{}  [checksum right]", describe(frame, self.direction))?;
                }
                Decoded::Damaged { id } => {
                    let name = id::name(id).map_or_else(|| format!("0x{id:02X}"), str::to_owned);
                    writeln!(output, "{before}{mark}{name}  [checksum wrong]")?;
                }
            }
        }
        let skipped = self.decoder.counters().skipped_bytes;
        if skipped > self.skipped {
            writeln!(output, "{before}{mark}({} bytes of no frame)", skipped - self.skipped)?;
            self.skipped = skipped;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(text: &str) -> String {
        let mut output = Vec::new();
        decode(text.as_bytes(), &mut output).unwrap();
        String::from_utf8(output).unwrap()
    }

    #[test]
    fn the_manuals_frames_are_readable() {
        let text = "AAh AAh AAh 20h 02h 00h 00h 00h B3h FDh\nAA AA AA 21 02 00 1A 00 67 CB\nAAAAAA2200000E76\n";
        let expected = "Homing -> E_SUCCESS  [checksum right]\nPrePosition -> E_CMD_PENDING  [checksum right]\n\
                        Stop  [checksum right]\n";
        assert_eq!(decoded(text), expected);
    }

    #[test]
    fn time_and_direction_are_kept() {
        let text = "12:00:01.250 > AA AA AA 22 00 00\n12:00:01.251 < AAAAAA 22 0200 0000 7CCA\n12:00:02 > 0E 76";
        let lines = decoded(text);
        assert!(lines.contains("12:00:02 > Stop  [checksum right]"), "{lines}");
        assert!(lines.starts_with("12:00:01.251 < Stop"), "{lines}");
    }

    #[test]
    fn damage_is_said() {
        assert!(decoded("AA AA AA 22 00 00 0E 77").contains("Stop  [checksum wrong]"));
        assert!(decoded("AA AA AA 22 00").contains("cut short"));
        assert!(decoded("00 01 02 AA AA AA 22 00 00 0E 76").contains("(3 bytes of no frame)"));
        let error = decode("AA\nzz".as_bytes(), &mut Vec::new()).unwrap_err();
        assert!(format!("{error:#}").starts_with("line 2: "), "{error:#}");
    }

    #[test]
    fn a_text_becomes_a_frame() {
        assert_eq!(encode("FastStop").unwrap(), "AA AA AA 23 00 00 AC 1C");
        assert_eq!(encode("Grip width=20 speed=50").unwrap(), "AA AA AA 25 08 00 00 00 A0 41 00 00 48 42 AA 1E");
        assert!(encode("Grip width=20").unwrap_err().to_string().contains("speed"));
    }
}
