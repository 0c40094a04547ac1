//! The log of a device whose values come and go.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

use super::*;

/// Counts the lines of the log.
struct CountedLines(Arc<AtomicUsize>);

impl Subscriber for CountedLines {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= Level::INFO
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, _: &Event<'_>) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[test]
fn flickering_value_does_not_fill_the_log() {
    let mut rig = Rig::connected(config(TCP));
    let lines = Arc::new(AtomicUsize::new(0));
    let counted = tracing::subscriber::set_default(CountedLines(lines.clone()));
    for _ in 0..300 {
        for force_n in [1e9_f32, 3.0] {
            rig.reply(id::GET_FORCE, Status::E_SUCCESS, &force_n.to_le_bytes());
        }
        rig.pass(10);
    }
    drop(counted);
    let lines = lines.load(Ordering::Relaxed);
    assert!((4..=20).contains(&lines), "{lines} lines in 3 s");
}
