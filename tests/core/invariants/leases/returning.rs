//! Clients that have lost the token of their lease, for example in a restart.

use gripper::{Conflict, Rejection};
use model::TakeLease;

use super::super::steps::*;
use super::{TTL, close, fast_stops, lease, submit_with, take, token, wish};

#[test]
fn missing_token_of_the_own_lease_is_named() {
    let mut world = homed();
    token(&mut world, wish("a"));
    let missing = |rejection| matches!(rejection, Rejection::Conflict(Conflict::LeaseTokenMissing { .. }));
    assert!(missing(take(&mut world, TakeLease { holder: None, ..wish("a") }).unwrap_err()));
    assert!(!missing(take(&mut world, wish("b")).unwrap_err()));
}

#[test]
fn restarted_client_gets_its_lease_back() {
    let mut world = homed();
    let old = token(&mut world, wish("a"));
    assert!(take(&mut world, wish("a")).is_err(), "the holder has just used its lease");
    world.advance(TTL / 2);
    let new = token(&mut world, wish("a"));
    assert_eq!(lease(&mut world).epoch, 2);
    let stale = submit_with(&mut world, move_to(50.0, 50.0), old).unwrap_err();
    assert_eq!(stale, Conflict::StaleLease { epoch: 2, holder: Some("a".into()) }.into());
    assert!(submit_with(&mut world, move_to(50.0, 50.0), new).is_ok());
}

#[test]
fn returning_client_does_not_bypass_the_loss_of_its_lease() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    let running = submit_with(&mut world, move_to(5.0, 10.0), a).unwrap();
    let from = mark(&world);
    close(&mut world, running);
    world.advance(TTL / 2);
    assert!(take(&mut world, wish("a")).is_err(), "the motion of the lost client still runs");
    world.advance(TTL);
    assert_eq!(fast_stops(&world, from), 1);
    assert!(take(&mut world, wish("a")).is_ok());
}

#[test]
fn open_request_keeps_the_lease_from_a_client_of_the_same_name() {
    let mut world = homed();
    let open = take(&mut world, wish("a")).unwrap();
    world.advance(TTL / 2);
    assert!(take(&mut world, wish("a")).is_err());
    close(&mut world, open.keep);
    world.advance(TTL / 2);
    assert!(take(&mut world, wish("a")).is_ok());
}
