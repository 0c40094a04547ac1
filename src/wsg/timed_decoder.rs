//! A decoder with time limits.

use std::time::{Duration, Instant};

use super::decoder::{Decoded, Decoder, DecoderCounters};

/// Shortest pause of a sender behind which a frame can begin after the [rejection](super::decoder) of another. It is
/// longer than the gaps within a frame, and shorter than the period of clients that poll.
pub const RESYNC_PAUSE: Duration = Duration::from_millis(5);

/// A [`Decoder`] that gives up frames whose rest is overdue.
///
/// A frame that is longer than it should be looks like one with a damaged size field. The time limit
/// distinguishes the two: a true frame is complete within `frame_within` of its first byte. Further bytes do not extend
/// this time, because a damaged size field must not hide the frames behind it for long.
#[derive(Debug)]
pub struct TimedDecoder {
    decoder: Decoder,
    frame_within: Duration,
    resync_pause: Duration,
    /// Time of the newest bytes.
    heard: Option<Instant>,
    /// Position of a frame that was incomplete before the newest bytes, and the time of its first byte.
    partial: Option<(u64, Instant)>,
    /// Time for which bytes behind a rejected frame are dropped at most; `None` if only a pause ends that.
    lost_within: Option<Duration>,
    lost_since: Option<Instant>,
}

impl TimedDecoder {
    /// Adds time limits to a decoder: `frame_within` from the first byte of a frame to its last, and `resync_pause` for
    /// [`Decoder::pause`].
    #[must_use]
    pub fn new(decoder: Decoder, frame_within: Duration, resync_pause: Duration) -> Self {
        Self { decoder, frame_within, resync_pause, heard: None, partial: None, lost_within: None, lost_since: None }
    }

    /// Drops bytes behind a rejected frame for no longer than a frame can take, also without a pause. This is for a
    /// sender whose silence would count as the loss of the link.
    #[must_use]
    pub fn with_limited_loss(self) -> Self {
        Self { lost_within: Some(self.frame_within), ..self }
    }

    /// Appends received bytes. After each call, call [`TimedDecoder::next`] until it returns `None`.
    pub fn push(&mut self, now: Instant, bytes: &[u8]) {
        self.partial = self.partial_since();
        if self.heard.is_none_or(|heard| heard + self.resync_pause <= now) {
            self.decoder.pause();
        }
        self.heard = Some(now);
        self.lost_since = self.decoder.is_lost().then(|| self.lost_since.unwrap_or(now));
        if let (Some(since), Some(within)) = (self.lost_since, self.lost_within)
            && since + within <= now
        {
            self.decoder.resynchronise();
        }
        self.decoder.push(bytes);
    }

    /// Returns the next finding, or `None` until more bytes arrive.
    #[allow(clippy::should_implement_trait, reason = "the result borrows from the decoder, unlike an Iterator's item")]
    pub fn next(&mut self) -> Option<Decoded<'_>> {
        self.decoder.next()
    }

    /// Names the opaque ids of the replies that can arrive now.
    pub fn expect_opaque(&mut self, ids: impl Iterator<Item = u8>) {
        self.decoder.expect_opaque(ids);
    }

    /// Time at which the rest of an incomplete frame counts as lost.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.partial_since().map(|(_, since)| since + self.frame_within)
    }

    /// Gives up a frame whose rest is overdue. Call [`TimedDecoder::next`] until it returns `None` afterwards.
    pub fn handle_timeout(&mut self, now: Instant) {
        if self.deadline().is_some_and(|deadline| deadline <= now) {
            self.decoder.give_up_partial();
        }
    }

    /// Gives up an incomplete frame at the end of a datagram: its rest cannot follow. The next datagram begins with a
    /// frame. Call [`TimedDecoder::next`] until it returns `None` before this and afterwards.
    pub fn end_datagram(&mut self) {
        self.decoder.give_up_partial();
        // The dropped bytes are looked at before the next ones.
        self.heard = None;
    }

    /// Whether the start of a frame is waiting for its remaining bytes.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        self.decoder.is_partial()
    }

    /// Current counter values.
    #[must_use]
    pub fn counters(&self) -> DecoderCounters {
        self.decoder.counters()
    }

    /// Position and time of the first byte of an incomplete frame.
    fn partial_since(&self) -> Option<(u64, Instant)> {
        if !self.decoder.is_partial() {
            return None;
        }
        let position = self.decoder.position();
        match self.partial {
            Some((same, since)) if same == position => Some((same, since)),
            _ => self.heard.map(|heard| (position, heard)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ChecksumEvaluation, frame, id};

    const WITHIN: Duration = Duration::from_millis(100);

    fn frames(decoder: &mut TimedDecoder) -> usize {
        std::iter::from_fn(|| decoder.next().map(|found| matches!(found, Decoded::Frame(_)))).filter(|is| *is).count()
    }

    /// A device that never pauses is heard again, and a client is not.
    #[test]
    fn bytes_behind_a_rejected_frame_are_dropped_for_a_limited_time_only_from_a_device() {
        for (is_limited, heard) in [(true, 3), (false, 0)] {
            let decoder = Decoder::of_requests(ChecksumEvaluation::On);
            let mut decoder = TimedDecoder::new(decoder, WITHIN, RESYNC_PAUSE);
            if is_limited {
                decoder = decoder.with_limited_loss();
            }
            let begin = Instant::now();
            decoder.push(begin, &[0xAA, 0xAA, 0xAA, id::LOOP, 0xFF, 0xFF]);
            assert_eq!(frames(&mut decoder), 0);
            assert_eq!(decoder.deadline(), Some(begin + WITHIN));
            decoder.push(begin + WITHIN, &[0]);
            decoder.handle_timeout(begin + WITHIN);
            let mut request = Vec::new();
            frame::encode(id::GET_SYSTEM_INFO, &[], &mut request);
            let mut found = 0;
            for n in 1..=53 {
                decoder.push(begin + WITHIN + 2 * n * Duration::from_millis(1), &request);
                found += frames(&mut decoder);
            }
            assert_eq!(found, heard);
            assert_eq!(decoder.deadline(), None);
            decoder.push(begin + 3 * WITHIN, &request);
            assert_eq!(frames(&mut decoder), 1, "after a pause");
        }
    }
}
