//! State besides leases that survives a gateway restart.

use std::time::Duration;

use super::steps::*;

#[test]
fn latch_epochs_grow_across_restarts() {
    let mut world = homed();
    let mut before = 0;
    for _ in 0..3 {
        let id = fast_stop(&mut world);
        let epoch = latch(&world).epoch;
        assert!(epoch > before, "{epoch} after {before}");
        world.advance(Duration::from_millis(200));
        acknowledge(&mut world, id);
        world.advance(Duration::from_millis(200));
        assert_eq!(state(&world).fast_stop, Some(false));
        world.restart();
        world.advance(Duration::from_secs(1));
        // The restart closed the connection without an announcement.
        let seen = latch(&world);
        assert!(seen.epoch > epoch, "{} after {epoch}", seen.epoch);
        before = seen.epoch;
        acknowledge(&mut world, seen.fast_stop_id);
        world.advance(Duration::from_millis(200));
    }
}
