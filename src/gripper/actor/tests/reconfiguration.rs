//! A new configuration for a running gripper.

use std::sync::Arc;

use super::*;
use crate::Connector;
use crate::handle::Reconfiguration;
use transport::Address;

const OTHER: &str = "tcp://192.168.1.21:1000";

fn reconfigure(rig: &mut Rig, config: ActorConfig, device: Option<&str>) -> oneshot::Receiver<()> {
    let connector = device.map(|url| Arc::new(url.parse::<Address>().unwrap()) as Arc<dyn Connector>);
    let change = Box::new(Reconfiguration { config, connector });
    let (answer, answered) = oneshot::channel();
    rig.actor.request(rig.now, ActorRequest::Reconfigure { change, answer });
    rig.exchange();
    answered
}

fn other_device() -> ActorConfig {
    ActorConfig { url: OTHER.to_owned(), ..config(TCP) }
}

#[test]
fn new_device_follows_a_clean_disconnect() {
    let mut rig = Rig::connected(config(TCP));
    rig.device.received.clear();
    let mut answered = reconfigure(&mut rig, other_device(), Some(OTHER));
    assert_eq!(rig.device.received.last().map(|(id, _)| *id), Some(id::DISCONNECT_ANNOUNCEMENT));
    assert!(rig.actor.is_reconfiguring() && answered.try_recv().is_err());
    assert_eq!(rig.actor.wants_close(), Some(Close::Drained));
    rig.actor.link_down(rig.now, "disconnected cleanly");
    assert!(!rig.actor.is_reconfiguring() && answered.try_recv().is_ok());
    assert_eq!(rig.actor.take_connector().unwrap().url(), OTHER);
    assert_eq!(rig.watches.info.borrow().url, OTHER);
    assert_eq!(rig.state().values.width_mm(rig.now.instant), None, "nothing is known of the new device");
}

#[test]
fn rules_change_without_a_new_link() {
    let mut rig = Rig::connected(config(TCP));
    rig.device.received.clear();
    let rules = GripperRules { fast_stop_on_disconnect: false, ..GripperRules::default() };
    let new = ActorConfig { rules, ..config(TCP) };
    assert!(reconfigure(&mut rig, new, None).try_recv().is_ok());
    assert!(rig.device.received.is_empty() && rig.actor.take_connector().is_none());
    assert_eq!(rig.state().link, model::Link::Connected);
    let info = rig.watches.info.borrow().clone();
    assert!(!info.stops_on_gateway_loss && info.serial_number.is_some());
}

#[test]
fn latch_survives_a_new_device() {
    let mut rig = Rig::connected(config(TCP));
    let id = rig.fast_stop();
    drop(reconfigure(&mut rig, other_device(), Some(OTHER)));
    rig.actor.link_down(rig.now, "disconnected cleanly");
    assert_eq!(rig.state().latch.as_ref().map(|latch| latch.fast_stop_id), Some(id));
}

#[test]
fn fast_stop_during_the_change_reaches_the_new_device() {
    let mut rig = Rig::connected(config(TCP));
    rig.device.held.insert(id::DISCONNECT_ANNOUNCEMENT);
    drop(reconfigure(&mut rig, other_device(), Some(OTHER)));
    rig.fast_stop();
    rig.actor.link_down(rig.now, "disconnected cleanly");
    rig.device.held.clear();
    rig.device.received.clear();
    rig.actor.link_up(rig.now);
    rig.exchange();
    assert_eq!(rig.device.received.first().map(|(id, _)| *id), Some(id::FAST_STOP));
}

#[test]
fn change_waits_for_no_link_that_is_down() {
    let mut rig = Rig::connected(config(TCP));
    rig.actor.link_down(rig.now, "unplugged");
    assert!(reconfigure(&mut rig, other_device(), Some(OTHER)).try_recv().is_ok());
    assert!(rig.actor.take_connector().is_some());
}
