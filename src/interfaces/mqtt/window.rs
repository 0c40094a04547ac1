//! The messages that wait for their PUBACK, in the order in which they were sent.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use rumqttc::v5::mqttbytes::v5::{PubAck, PubAckReason};

use super::failure::MqttFailure;
use super::position::{Position, RecordStep};

/// Largest number of records that wait for their PUBACK. It hides the time that a broker takes for one.
const MAX_RECORDS: usize = 32;

/// Places for other messages: availability, description and alarms.
const MAX_OTHERS: usize = 4;

/// Time limit of a PUBACK.
const ACKNOWLEDGED_WITHIN: Duration = Duration::from_secs(30);

#[derive(Debug)]
pub(super) struct Window {
    waiting: VecDeque<InFlight>,
    last_id: u16,
    max_records: usize,
    max: usize,
}

#[derive(Debug)]
struct InFlight {
    packet_id: u16,
    topic: String,
    sent_at: Instant,
    is_acknowledged: bool,
    /// Step through the journal that the acknowledgement completes.
    step: Option<RecordStep>,
}

impl Window {
    /// Returns the window for a broker with this receive maximum.
    pub(super) fn new(receive_maximum: u16) -> Self {
        let max = usize::from(receive_maximum).clamp(1, MAX_RECORDS + MAX_OTHERS);
        let max_records = max.saturating_sub(MAX_OTHERS).max(1);
        Self { waiting: VecDeque::new(), last_id: 0, max_records, max }
    }

    /// Whether another record may be sent.
    pub(super) fn has_room_for_record(&self) -> bool {
        self.waiting.len() < self.max_records
    }

    /// Whether another message may be sent.
    pub(super) fn has_room(&self) -> bool {
        self.waiting.len() < self.max
    }

    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Takes a message in, and returns its packet id.
    pub(super) fn add(&mut self, topic: &str, step: Option<RecordStep>, now: Instant) -> u16 {
        // Ids in use are less than `max` behind, so none is used twice.
        self.last_id = self.last_id.checked_add(1).unwrap_or(1);
        self.waiting.push_back(InFlight {
            packet_id: self.last_id,
            topic: topic.to_owned(),
            sent_at: now,
            is_acknowledged: false,
            step,
        });
        self.last_id
    }

    /// Takes a PUBACK, and advances `position` over all records before the first one that still waits.
    pub(super) fn acknowledge(&mut self, answer: &PubAck, position: &mut Position) -> Result<(), MqttFailure> {
        let found = self.waiting.iter_mut().find(|message| message.packet_id == answer.pkid);
        let message = found.ok_or_else(|| MqttFailure::Invalid(format!("PUBACK of message {}", answer.pkid)))?;
        if !matches!(answer.reason, PubAckReason::Success | PubAckReason::NoMatchingSubscribers) {
            return Err(MqttFailure::PublishRefused { topic: message.topic.clone(), reason: answer.reason });
        }
        message.is_acknowledged = true;
        while let Some(message) = self.waiting.pop_front_if(|message| message.is_acknowledged) {
            if let Some(step) = message.step {
                position.advance(step);
            }
        }
        Ok(())
    }

    /// # Errors
    /// The broker has not acknowledged a message in time.
    pub(super) fn check(&self, now: Instant) -> Result<(), MqttFailure> {
        match self.waiting.front() {
            Some(message) if now.saturating_duration_since(message.sent_at) > ACKNOWLEDGED_WITHIN => {
                Err(MqttFailure::Silent(ACKNOWLEDGED_WITHIN))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::position::PublishedList;
    use super::*;

    fn acknowledge(window: &mut Window, packet_id: u16, position: &mut Position) -> Result<(), MqttFailure> {
        window.acknowledge(&PubAck::new(packet_id, None), position)
    }

    #[test]
    fn position_advances_in_order_whatever_the_order_of_acknowledgements() {
        let now = Instant::now();
        let mut window = Window::new(100);
        let mut position = Position { events: 7, grips: 3 };
        let first = window.add("events", Some(RecordStep { chain: PublishedList::Events, seq: 8 }), now);
        let state = window.add("alarms", None, now);
        let grip = window.add("grips", Some(RecordStep { chain: PublishedList::Grips, seq: 4 }), now);
        acknowledge(&mut window, grip, &mut position).unwrap();
        acknowledge(&mut window, state, &mut position).unwrap();
        assert_eq!(position, Position { events: 7, grips: 3 });
        acknowledge(&mut window, first, &mut position).unwrap();
        assert_eq!(position, Position { events: 8, grips: 4 });
        assert!(window.is_empty() && acknowledge(&mut window, first, &mut position).is_err());
    }

    #[test]
    fn refused_record_is_not_delivered() {
        let mut window = Window::new(100);
        let mut position = Position::default();
        let id = window.add("a/events", Some(RecordStep { chain: PublishedList::Events, seq: 1 }), Instant::now());
        let refusal = PubAck { reason: PubAckReason::NotAuthorized, ..PubAck::new(id, None) };
        let error = window.acknowledge(&refusal, &mut position).unwrap_err().to_string();
        assert!(error.contains("a/events") && error.contains("NotAuthorized"), "{error}");
        assert_eq!(position, Position::default());
    }

    #[test]
    fn window_is_bounded_and_late_acknowledgement_is_noticed() {
        let begin = Instant::now();
        let mut window = Window::new(20);
        while window.has_room_for_record() {
            window.add("grips", None, begin);
        }
        assert_eq!(window.waiting.len(), 16);
        while window.has_room() {
            window.add("alarms", None, begin);
        }
        assert_eq!(window.waiting.len(), 20);
        assert!(window.check(begin + ACKNOWLEDGED_WITHIN).is_ok());
        assert!(window.check(begin + ACKNOWLEDGED_WITHIN + Duration::from_millis(1)).is_err());
        let sizes = [0, 1, 3, 5, 20, u16::MAX].map(|given| {
            let window = Window::new(given);
            (window.max_records, window.max)
        });
        assert_eq!(sizes, [(1, 1), (1, 1), (1, 3), (1, 5), (16, 20), (MAX_RECORDS, MAX_RECORDS + MAX_OTHERS)]);
    }

    #[test]
    fn packet_ids_begin_again_at_one() {
        let mut window = Window::new(100);
        window.last_id = u16::MAX;
        assert_eq!(window.add("events", None, Instant::now()), 1);
    }
}
