//! Measured values that the device no longer sends, or sends wrongly: they are unknown, on their own.

use std::time::Duration;

use gripper::{Failure, Rejection};
use model::{Detail, DeviceEvent, Fault, Link, Outcome, UpdateMode};
use sim::{BrokenGetter, Change, Interface};
use wsg::{self, Status, Updates, id};

use super::steps::*;
use crate::seeds::world::World;

fn break_getter(world: &mut World, id: u8, how: BrokenGetter) {
    world.device.apply(world.now, Change::BreakGetter { id, how });
}

fn mend(world: &mut World) {
    world.device.apply(world.now, Change::MendGetters);
}

/// Reports of values in the journal: the names, and whether they became unknown.
fn reports(world: &World) -> Vec<(Vec<&'static str>, bool)> {
    let report = |event: &Detail| match event {
        Detail::Device(DeviceEvent::ValuesUnknown { values, .. }) => Some((values.clone(), true)),
        Detail::Device(DeviceEvent::ValuesKnown { values }) => Some((values.clone(), false)),
        _ => None,
    };
    world.journal.events.iter().filter_map(report).collect()
}

#[test]
fn value_that_is_not_renewed_is_unknown() {
    let mut world = homed();
    break_getter(&mut world, id::GET_WIDTH, BrokenGetter::Silent);
    world.advance(Duration::from_millis(400));
    assert_eq!((values(&world).width_mm, values(&world).stale.len()), (Some(109.0), 0));
    world.advance(Duration::from_millis(200));
    let shown = values(&world);
    assert_eq!((shown.width_mm, shown.stale), (None, vec!["width_mm"]));
    assert_eq!((shown.referenced, shown.state, shown.force_n), (Some(true), Some("IDLE"), Some(0.0)));
    assert!(shown.age_ms.is_some_and(|age_ms| age_ms < 100), "{:?}", shown.age_ms);
    assert_eq!((state(&world).link, state(&world).fault_code), (Link::Connected, Fault::ValueUnknown.code()));
    world.advance(Duration::from_secs(5));
    mend(&mut world);
    world.advance(Duration::from_secs(1));
    assert_eq!((values(&world).width_mm, values(&world).stale.len()), (Some(109.0), 0));
    assert!(!state(&world).fault);
    assert_eq!(reports(&world), [(vec!["width_mm"], true), (vec!["width_mm"], false)], "once each");
}

#[test]
fn error_or_impossible_number_makes_a_value_unknown_at_once() {
    for how in [BrokenGetter::Status { code: Status::E_NOT_AVAILABLE.code() }, BrokenGetter::NotANumber] {
        let mut world = homed();
        break_getter(&mut world, id::GET_FORCE, how);
        world.advance(Duration::from_millis(30));
        let shown = values(&world);
        assert_eq!((shown.force_n, shown.stale), (None, vec!["force_n"]), "{how:?}");
        mend(&mut world);
        world.advance(Duration::from_millis(30));
        assert_eq!(values(&world).force_n, Some(0.0), "{how:?}");
    }
}

#[test]
fn values_of_a_lost_link_are_unknown() {
    let mut world = homed();
    world.disconnected("unplugged");
    let shown = values(&world);
    assert_eq!((shown.width_mm, shown.state, shown.flags_raw, shown.age_ms), (None, None, None, None));
    assert_eq!((shown.measured_at, shown.stale.len(), state(&world).fast_stop), (None, 0, None));
    world.advance(Duration::from_secs(2));
    assert_eq!((values(&world).width_mm, state(&world).fast_stop), (Some(109.0), Some(true)));
    assert_eq!(reports(&world), [], "the link's own event says it");
}

#[test]
fn unknown_flags_make_the_link_unresponsive() {
    let mut world = homed();
    break_getter(&mut world, id::GET_SYSTEM_STATE, BrokenGetter::Silent);
    break_getter(&mut world, id::GET_WIDTH, BrokenGetter::Silent);
    world.advance(Duration::from_millis(600));
    assert_eq!((values(&world).flags_raw, state(&world).fast_stop), (None, None));
    let refusal = refused(&mut world, move_to(50.0, 50.0));
    assert!(matches!(refusal, Rejection::Failure(Failure::FlagsUnknown { .. })), "{refusal:?}");
    world.advance(Duration::from_millis(900));
    assert_eq!(state(&world).link, Link::Unresponsive);
    let cause = state(&world).link_cause.unwrap();
    assert!(cause.contains("flags (not sent by the device), width_mm ("), "{cause}");
    assert!(values(&world).force_n.is_some(), "what the device sends is shown");
    let from = mark(&world);
    fast_stop(&mut world);
    world.advance(Duration::from_millis(100));
    assert!(received(&world, from).contains(&id::FAST_STOP));
    assert_eq!(state(&world).fast_stop, Some(true), "latched here");
    mend(&mut world);
    world.advance(Duration::from_secs(1));
    assert_eq!((state(&world).link, latch(&world).fast_stop_confirmed), (Link::Connected, true));
}

#[test]
fn flags_that_return_do_not_set_up_a_tcp_link_again() {
    let mut world = homed();
    break_getter(&mut world, id::GET_SYSTEM_STATE, BrokenGetter::Silent);
    world.advance(Duration::from_secs(20));
    assert_eq!(state(&world).link, Link::Unresponsive, "not closed: the device answers");
    mend(&mut world);
    world.advance(Duration::from_millis(300));
    assert_eq!(state(&world).link, Link::Connected);
    assert_eq!(run(&mut world, move_to(50.0, 100.0)).outcome, Some(Outcome::Success));
}

#[test]
fn result_has_no_value_from_before_its_end() {
    let mut world = homed();
    let running = start(&mut world, move_to(60.0, 200.0));
    world.advance(Duration::from_millis(200));
    break_getter(&mut world, id::GET_WIDTH, BrokenGetter::Silent);
    let command = finish(&mut world, &running);
    assert_eq!((command.outcome, command.width_mm), (Some(Outcome::Success), None));
    assert_eq!(command.force_n, Some(0.0), "the force is known");
}

#[test]
fn query_of_an_unknown_value_says_why() {
    let mut world = homed();
    break_getter(&mut world, id::GET_FORCE, BrokenGetter::Status { code: 8 });
    world.advance(Duration::from_millis(100));
    let mut asked = exchange(&mut world, wsg::Command::GetForce(Updates::Off));
    let rejection = asked.try_recv().unwrap().unwrap_err().to_string();
    assert_eq!(rejection, "the value of GetForce is unknown: the device answers E_READ_ERROR (8)");
}

#[test]
fn values_sent_on_change_are_good_while_they_are_polled() {
    let mut world = World::calm_on(Interface::Can, device(), None);
    world.config.rules.updates.mode = UpdateMode::Changes;
    world.restart();
    world.advance(Duration::from_secs(1));
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    for _ in 0..200 {
        world.advance(Duration::from_millis(25));
        assert!(values(&world).stale.is_empty(), "{:?}", values(&world));
    }
    break_getter(&mut world, id::GET_WIDTH, BrokenGetter::Silent);
    world.advance(Duration::from_millis(1600));
    assert_eq!(values(&world).stale, ["width_mm"]);
}

#[test]
fn temperature_is_unknown_after_three_missed_polls() {
    let mut world = homed();
    world.advance(Duration::from_secs(1));
    assert!(values(&world).temperature_c.is_some());
    break_getter(&mut world, id::GET_TEMPERATURE, BrokenGetter::Silent);
    world.advance(Duration::from_secs(9));
    assert!(values(&world).temperature_c.is_some(), "two polls were missed at most");
    world.advance(Duration::from_secs(8));
    assert_eq!((values(&world).temperature_c, values(&world).stale), (None, vec!["temperature_c"]));
}

#[test]
fn time_of_measurement_never_goes_back() {
    let mut world = homed();
    let mut newest = values(&world).measured_at;
    for _ in 0..50 {
        world.advance(Duration::from_millis(7));
        let measured_at = values(&world).measured_at;
        assert!(measured_at >= newest, "{measured_at:?} after {newest:?}");
        newest = measured_at;
    }
    // The wall clock of this world began with it.
    let shown = newest.unwrap().as_microsecond();
    let elapsed = (world.now - world.start).as_micros() as i64;
    assert!((elapsed - 20_000..=elapsed).contains(&shown), "{shown} of {elapsed}");
    world.wall_offset = jiff::SignedDuration::from_hours(-1);
    world.advance(Duration::from_millis(50));
    assert!(values(&world).measured_at > newest, "a step of the clock does not count");
}
