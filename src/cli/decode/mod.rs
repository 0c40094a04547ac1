//! `wsg-gateway decode`: hex to readable frames, one per line, and back.
//!
//! A line of input is hex, optionally preceded by a time and a direction: `>` or `->` to the device, `<` or `<-` from
//! the device. A frame can span several lines of the same direction. Lines that begin with `#` are comments.

mod follow;

use std::io::{self, BufRead, Write};

use crate::wsg::frame::PREAMBLE;
use crate::wsg::text::{WireDirection, describe, describe_damaged, describe_skipped, describe_too_long};
use crate::wsg::{ChecksumEvaluation, Command, Decoded, Decoder, id};

pub(super) use follow::follow;

/// Encodes the frame that a text describes, as hex.
///
/// # Errors
/// The fault in the text.
pub(super) fn encode(text: &str) -> anyhow::Result<String> {
    let command: Command = text.parse()?;
    let mut frame = Vec::new();
    command.encode(&mut frame);
    let bytes: Vec<_> = frame.iter().map(|byte| format!("{byte:02X}")).collect();
    Ok(bytes.join(" "))
}

/// Reads lines of hex and writes one line per frame. Copies comments, and marks lines that it cannot decode. Returns
/// the number of marked lines.
///
/// # Errors
/// Any read or write error.
pub(super) fn decode(input: impl BufRead, output: &mut impl Write) -> io::Result<usize> {
    let mut streams = [WireDirection::Request, WireDirection::Reply, WireDirection::Unknown].map(Stream::new);
    let mut wrong = 0;
    for (index, line) in input.split(b'\n').enumerate() {
        let line = line?;
        let text = String::from_utf8_lossy(&line);
        match text.trim() {
            "" => {}
            comment if comment.starts_with('#') => writeln!(output, "{comment}")?,
            text => match Line::parse(text) {
                Ok(line) => {
                    for stream in streams.iter_mut().filter(|stream| stream.direction == line.direction) {
                        stream.take(&line, output)?;
                    }
                }
                Err(error) => {
                    wrong += 1;
                    writeln!(output, "{text}  [line {} not decoded: {error}]", index + 1)?;
                }
            },
        }
    }
    for stream in &streams {
        if stream.decoder.is_partial() {
            writeln!(output, "{}frame cut short at the end of the input", stream.mark())?;
        }
    }
    Ok(wrong)
}

struct Line<'a> {
    time: &'a str,
    direction: WireDirection,
    bytes: Vec<u8>,
}

impl<'a> Line<'a> {
    fn parse(text: &'a str) -> Result<Self, String> {
        let (time, direction, digits) = if let Some(at) = text.find(['>', '<']) {
            let before = &text[..at];
            let behind = &text[at + 1..];
            if text[at..].starts_with('>') {
                (before.strip_suffix('-').unwrap_or(before), WireDirection::Request, behind)
            } else {
                (before, WireDirection::Reply, behind.strip_prefix('-').unwrap_or(behind))
            }
        } else {
            let at = text.len() - without_time(text).len();
            (&text[..at], WireDirection::Unknown, &text[at..])
        };
        Ok(Self { time: time.trim(), direction, bytes: all_bytes(digits)? })
    }
}

/// Returns a line from its first byte on. A word that is not hex counts as time, as does a number right before a frame.
fn without_time(line: &str) -> &str {
    let mut rest = line;
    while let Some((word, behind)) = rest.split_once(char::is_whitespace) {
        let behind = behind.trim_start();
        let is_number = word.len() > 2 && word.bytes().all(|byte| byte.is_ascii_digit());
        let is_time = is_number && all_bytes(behind).is_ok_and(|bytes| bytes.starts_with(&PREAMBLE));
        if bytes(word).is_ok() && !is_time {
            return rest;
        }
        rest = behind;
    }
    // Only the last word is left. If that is not hex either, the line has no bytes.
    if bytes(rest).is_ok() { rest } else { line }
}

fn all_bytes(text: &str) -> Result<Vec<u8>, String> {
    let words = text.split(|character: char| character.is_whitespace() || character == ',');
    let parsed: Result<Vec<_>, _> = words.filter(|word| !word.is_empty()).map(bytes).collect();
    Ok(parsed?.concat())
}

/// Parses bytes written as `AA`, `AAh`, `0xAA` or `AAAAAA25`.
fn bytes(word: &str) -> Result<Vec<u8>, String> {
    let digits = word.trim_start_matches("0x").trim_end_matches(['h', 'H']);
    hex::decode(digits).map_err(|_| format!("{word:?} is not hex: write bytes as AA AA AA 22 00 00 0E 76"))
}

/// The bytes of one direction.
struct Stream {
    direction: WireDirection,
    decoder: Decoder,
    skipped: u64,
}

impl Stream {
    fn new(direction: WireDirection) -> Self {
        let decoder = match direction {
            WireDirection::Request => Decoder::of_requests(ChecksumEvaluation::On),
            WireDirection::Reply | WireDirection::Unknown => {
                Decoder::new(id::max_request_bytes, ChecksumEvaluation::On)
            }
        };
        Self { direction, decoder, skipped: 0 }
    }

    fn mark(&self) -> &'static str {
        match self.direction {
            WireDirection::Request => "> ",
            WireDirection::Reply => "< ",
            WireDirection::Unknown => "",
        }
    }

    fn take(&mut self, line: &Line<'_>, output: &mut impl Write) -> std::io::Result<()> {
        self.decoder.pause();
        self.decoder.push(&line.bytes);
        let before = if line.time.is_empty() { String::new() } else { format!("{} ", line.time) };
        let mark = self.mark();
        while let Some(decoded) = self.decoder.next() {
            match decoded {
                Decoded::Frame(frame) => {
                    writeln!(output, "{before}{mark}{}  [checksum ok]", describe(frame, self.direction))?;
                }
                Decoded::Damaged { id } => {
                    writeln!(output, "{before}{mark}{}", describe_damaged(id))?;
                }
                Decoded::TooLong { id, payload_bytes } => {
                    writeln!(output, "{before}{mark}{}  [checksum ok]", describe_too_long(id, payload_bytes))?;
                }
                Decoded::MissedFastStop => {
                    writeln!(output, "{before}{mark}FastStop  [in damaged bytes]")?;
                }
            }
        }
        let skipped = self.decoder.counters().skipped_bytes;
        if skipped > self.skipped {
            writeln!(output, "{before}{mark}{}", describe_skipped(skipped - self.skipped))?;
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
        assert_eq!(decode(text.as_bytes(), &mut output).unwrap(), 0, "every line is decoded");
        String::from_utf8(output).unwrap()
    }

    #[test]
    fn frames_from_the_manual_are_readable() {
        let text = "AAh AAh AAh 20h 02h 00h 00h 00h B3h FDh\nAA AA AA 21 02 00 1A 00 67 CB\nAAAAAA2200000E76\n";
        let expected = "Homing -> E_SUCCESS  [checksum ok]\nPrePosition -> E_CMD_PENDING  [checksum ok]\n\
                        Stop  [checksum ok]\n";
        assert_eq!(decoded(text), expected);
    }

    #[test]
    fn time_and_direction_are_kept() {
        let text = "12:00:01.250 > AA AA AA 22 00 00\n12:00:01.251 < AAAAAA 22 0200 0000 7CCA\n12:00:02 > 0E 76";
        let lines = decoded(text);
        assert!(lines.contains("12:00:02 > Stop  [checksum ok]"), "{lines}");
        assert!(lines.starts_with("12:00:01.251 < Stop"), "{lines}");
    }

    #[test]
    fn number_before_a_frame_is_a_time() {
        for time in ["12.345", "1732182000", "1732182000.250", "12:00:01", "0250"] {
            let line = decoded(&format!("{time} AA AA AA 22 00 00 0E 76"));
            assert_eq!(line, format!("{time} Stop  [checksum ok]\n"));
        }
        assert_eq!(decoded("AAAAAA 22\n0000 0E76"), "Stop  [checksum ok]\n");
        assert_eq!(decoded("AAAAAA22 0000\n12.345 0E 76"), "12.345 Stop  [checksum ok]\n");
    }

    #[test]
    fn direction_can_be_an_arrow() {
        let (request, reply) = ("AA AA AA 22 00 00 0E 76", "AA AA AA 20 02 00 00 00 B3 FD");
        let expected = "12.345 > Stop  [checksum ok]\n12.346 < Homing -> E_SUCCESS  [checksum ok]\n";
        assert_eq!(decoded(&format!("12.345 -> {request}\n12.346 <- {reply}")), expected);
        assert_eq!(decoded(&format!("12.345->{request}\n12.346<-{reply}")), expected);
    }

    #[test]
    fn comments_are_copied() {
        let line = "# 12.345 -> a homing, not hex";
        assert_eq!(decoded(&format!("{line}\n\nAAAAAA2200000E76")), format!("{line}\nStop  [checksum ok]\n"));
    }

    #[test]
    fn undecodable_lines_are_marked_and_counted() {
        let mut output = Vec::new();
        let input = b"zz\nAA AA AA 22 0 0\n\xFF\nAAAAAA2200000E76\n";
        assert_eq!(decode(&input[..], &mut output).unwrap(), 3);
        let output = String::from_utf8(output).unwrap();
        let lines: Vec<_> = output.lines().collect();
        assert!(lines[0].starts_with("zz  [line 1 not decoded: \"zz\" is not hex: "), "{output}");
        assert!(lines[1].starts_with("AA AA AA 22 0 0  [line 2 not decoded: \"0\" is not hex: "), "{output}");
        assert_eq!(lines[3], "Stop  [checksum ok]");
    }

    #[test]
    fn damaged_frames_are_marked() {
        assert!(decoded("AA AA AA 22 00 00 0E 77").contains("Stop  [checksum wrong]"));
        assert!(decoded("AA AA AA 22 00").contains("cut short"));
        assert!(decoded("00 01 02 AA AA AA 22 00 00 0E 76").contains("(3 bytes outside any frame)"));
    }

    #[test]
    fn payload_of_a_request_is_not_decoded() {
        let mut inside = Vec::new();
        Command::Stop.encode(&mut inside);
        let mut bytes = Vec::new();
        crate::wsg::frame::encode(id::LOOP, &[inside, vec![0; 5000]].concat(), &mut bytes);
        let expected = "> Loop  (5008 bytes, too many to be shown)  [checksum ok]\n";
        assert_eq!(decoded(&format!("-> {}", hex::encode(bytes))), expected);
    }

    #[test]
    fn text_is_encoded() {
        assert_eq!(encode("FastStop").unwrap(), "AA AA AA 23 00 00 AC 1C");
        assert_eq!(encode("Grip width=20 speed=50").unwrap(), "AA AA AA 25 08 00 00 00 A0 41 00 00 48 42 AA 1E");
        assert!(encode("Grip width=20").unwrap_err().to_string().contains("speed"));
    }
}
