use crate::testing::*;
use crate::{Change, DeviceConfig, Interface, Part};
use wsg::{Command, Data, GripperState, Reply, SystemState, Updates, id};

#[test]
fn updates_are_periodic_and_look_like_replies() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.ask(&Command::GetGripperState(updates(false, 20))).len(), 1, "switching on gets a reply");
    let idle = (id::GET_GRIPPER_STATE, Reply::Success(Data::GripperState(GripperState::Idle)));
    assert_eq!(bench.pass(ms(19)), []);
    assert_eq!(bench.pass(ms(1)), [idle]);
    assert_eq!(bench.pass(ms(200)).len(), 10);
}

#[test]
fn reply_to_switching_updates_on_is_optional() {
    let mut bench = Bench::new(DeviceConfig { answers_update_requests: false, ..DeviceConfig::wsg50() });
    assert_eq!(bench.ask(&Command::GetForce(updates(false, 20))), []);
    assert_eq!(bench.pass(ms(20)).len(), 1);
}

#[test]
fn shortest_period_is_10_ms() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.ask(&Command::GetSpeed(updates(false, 1)));
    assert_eq!(bench.pass(ms(100)).len(), 10);
}

#[test]
fn updates_of_equal_period_share_cycle() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&Command::GetWidth(updates(false, 20)));
    assert_eq!(bench.pass(ms(7)), []);
    bench.ask(&Command::GetForce(updates(false, 20)));
    assert_eq!(bench.pass(ms(12)), []);
    for _ in 0..3 {
        let together: Vec<_> = bench.pass(ms(1)).into_iter().map(|(id, _)| id).collect();
        assert_eq!(together, [id::GET_WIDTH, id::GET_FORCE]);
        assert_eq!(bench.pass(ms(19)), []);
    }
}

#[test]
fn query_without_updates_switches_them_off() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.ask(&Command::GetSpeed(updates(false, 10)));
    assert_eq!(bench.ask(&Command::GetSpeed(Updates::Off)).len(), 1);
    assert_eq!(bench.pass(ms(100)), []);
    assert_eq!(bench.device.poll_timeout(), None);
}

#[test]
fn on_change_sends_nothing_without_change() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    for command in [
        Command::GetSystemState(updates(true, 10)),
        Command::GetGripperState(updates(true, 10)),
        Command::GetWidth(updates(true, 10)),
        Command::GetSpeed(updates(true, 10)),
        Command::GetForce(updates(true, 10)),
    ] {
        bench.ask(&command);
    }
    bench.pass(ms(20));
    assert_eq!(bench.pass(ms(1000)), []);
}

#[test]
fn on_change_period_is_shortest_interval() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&Command::GetWidth(updates(true, 50)));
    bench.ask(&move_to(50.0, 100.0));
    let mut last = None;
    let mut widths = 0;
    for _ in 0..800 {
        for (id, _) in bench.pass(ms(1)) {
            if id == id::GET_WIDTH {
                widths += 1;
                assert!(last.replace(bench.now).is_none_or(|last| bench.now - last >= ms(50)));
            }
        }
    }
    // One per interval over 635 ms of motion, plus one at its end.
    assert!((12..=14).contains(&widths), "{widths}");
}

#[test]
fn state_change_is_sent_at_once_after_interval() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&Command::GetSystemState(updates(true, 10)));
    bench.pass(ms(100));
    let frames = bench.ask(&Command::FastStop);
    assert_eq!(frames[0], (id::FAST_STOP, DONE));
    let Reply::Success(Data::SystemState(flags)) = frames[1].1 else { panic!("{frames:?}") };
    assert!(flags.contains(SystemState::FAST_STOP));
}

#[test]
fn change_below_threshold_is_ignored() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&Command::GetWidth(updates(true, 10)));
    bench.pass(ms(20));
    let widths = |frames: Vec<(u8, Reply)>| frames.iter().filter(|(id, _)| *id == id::GET_WIDTH).count();
    bench.ask(&move_by(-0.005, 50.0));
    assert_eq!(widths(bench.pass(ms(100))), 0);
    bench.ask(&move_by(-0.1, 50.0));
    assert!(widths(bench.pass(ms(100))) > 0);
}

#[test]
fn fw4_sends_no_width_before_reference() {
    for (config, told) in [(DeviceConfig::wsg50(), false), (DeviceConfig::wsg50().fw2(), true)] {
        let mut bench = Bench::new(config);
        let zero = Reply::Success(Data::Width(width(0.0)));
        assert_eq!(bench.reply(&Command::GetWidth(updates(true, 10))), zero);
        bench.ask(&Command::Homing(wsg::HomingDirection::Inner));
        let frames = bench.pass(ms(500));
        assert_eq!(frames.iter().any(|(id, _)| *id == id::GET_WIDTH), told);
        let frames = bench.pass(ms(3000));
        assert!(frames.iter().any(|(id, _)| *id == id::GET_WIDTH), "homing changes the width");
    }
}

#[test]
fn force_is_updated_while_it_builds_up() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.apply(Change::PlacePart(Part::outside(20.0)));
    bench.ask(&Command::GetForce(updates(true, 10)));
    bench.ask(&grip(20.0, 100.0));
    let forces: Vec<f32> = bench
        .pass(ms(3000))
        .into_iter()
        .filter_map(|(_, reply)| if let Reply::Success(Data::Force(force)) = reply { Some(force.n()) } else { None })
        .collect();
    assert!(forces.len() >= 2 && forces.is_sorted(), "{forces:?}");
    assert!(near(f64::from(*forces.last().unwrap()), 40.0));
}

#[test]
fn updates_end_with_connection() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.ask(&Command::GetSpeed(updates(false, 10)));
    bench.device.disconnect(bench.now);
    assert!(bench.device.connect(bench.now, Interface::Tcp));
    assert_eq!(bench.pass(ms(100)), []);
    assert!(bench.snapshot().updates.is_empty());
}

#[test]
fn unfetched_updates_are_dropped_but_not_replies() {
    let mut bench = Bench::on(DeviceConfig::wsg50(), Interface::Udp);
    bench.ask(&Command::GetSpeed(updates(false, 10)));
    let mut request = Vec::new();
    looped(&[7]).encode(&mut request);
    bench.device.receive(bench.now, &request);
    bench.now += ms(60_000);
    bench.device.handle_timeout(bench.now);
    let snapshot = bench.snapshot();
    assert_eq!(snapshot.queued_frames, crate::MAX_QUEUED_FRAMES);
    assert_eq!(snapshot.dropped_updates, 6000 + 1 - 256);
    assert_eq!(bench.frames()[0], (id::LOOP, Reply::Success(Data::Loop(vec![7]))));
}
