//! Commands of the gateway map.

use serde_json::json;
use tokio_modbus::client::{Reader as _, Writer as _};
use tokio_modbus::prelude::ExceptionCode;

use super::{
    ACKNOWLEDGE, BUSY, COUNTER, Cell, DONE, FAST_STOP, FAST_STOP_REGISTER, GRIP, HOLDING, HOME, LATCHED, MINE, MOVE,
    MOVING, NOK, NONE, OK, OTHERS, PREPARED, Plc, READY, RELEASE, RELEASE_LEASE, STOP, TAKE_LEASE, Values, until_free,
};

/// Outcomes.
const SUCCESS: u16 = 1;
const PART_HELD: u16 = 2;
const ABORTED: u16 = 5;
const WRONG_PART: u16 = 11;

/// Problems.
const NOT_FOUND: u16 = 4;
const FAST_STOP_LATCHED: u16 = 8;
const LEASE_HELD: u16 = 12;
const STALE_FAST_STOP: u16 = 14;
const OUT_OF_RANGE: u16 = 18;

fn recipe(number: u16) -> Values {
    Values { recipe: number, ..Values::default() }
}

#[tokio::test]
async fn cycle_by_recipe_number() {
    let (cell, mut plc) = Cell::homed().await;
    let fields = json!({"number": 12, "width_mm": 20, "speed_mm_s": 200, "force_n": 30, "accept_min_mm": 19,
        "accept_max_mm": 21, "release_width_mm": 35});
    assert_eq!(cell.gateway.put("/api/v1/recipes/A-1047", &fields).await.status, 201);
    let held = plc.ok(GRIP, recipe(12)).await;
    assert_eq!((held.outcome, held.problem, held.status & HOLDING), (PART_HELD, 0, HOLDING), "{held:?}");
    assert!(held.contact_width.abs_diff(2000) < 50 && held.peak_force.abs_diff(300) < 20, "{held:?}");
    let released = plc.ok(RELEASE, recipe(12)).await;
    assert_eq!((released.outcome, released.status & HOLDING), (SUCCESS, 0));
    assert!(released.width.abs_diff(3500) < 50, "{released:?}");
    assert_eq!(released.contact_width, held.contact_width, "of the last grip");

    let wrong = json!({"number": 13, "width_mm": 20, "speed_mm_s": 200, "accept_min_mm": 25});
    assert_eq!(cell.gateway.put("/api/v1/recipes/B", &wrong).await.status, 201);
    let wrong = plc.ended(GRIP, recipe(13)).await;
    assert_eq!((wrong.outcome, wrong.status & (OK | NOK | HOLDING)), (WRONG_PART, NOK | HOLDING), "{wrong:?}");
    let weaker = Values { force: 100, options: 4, ..recipe(12) };
    plc.ok(RELEASE, recipe(12)).await;
    assert!(plc.ok(GRIP, weaker).await.peak_force.abs_diff(100) < 20, "overridden");
}

#[tokio::test]
async fn repeated_write_moves_nothing_twice() {
    let (cell, mut plc) = Cell::homed().await;
    plc.ok(MOVE, Values::at(4000, 2000)).await;
    let motions = cell.proxy.frames.motions();
    let again = [plc.counter, MOVE, 0, 4000, 2000];
    for _ in 0..3 {
        plc.write(COUNTER, &again).await.unwrap();
    }
    drop(plc);
    until_free(&cell.gateway).await;
    // A new connection begins with registers of 0, and executes no old command.
    let mut plc = Plc::connect(cell.address).await;
    for counter in [again[0], again[0] + 1] {
        plc.write(COUNTER, &[counter, MOVE, 0, 4000, 2000]).await.unwrap();
        let seen = plc.seen().await;
        assert_eq!((seen.counter, seen.status & (PREPARED | DONE)), (0, 0), "{seen:?}");
    }
    assert_eq!(cell.proxy.frames.motions(), motions);
    let mut plc = Plc::ready(cell.address).await;
    plc.ok(MOVE, Values::at(3000, 2000)).await;
    assert_eq!(cell.proxy.frames.motions(), motions + 1);
}

#[tokio::test]
async fn command_before_command_0_is_not_executed() {
    let cell = Cell::start().await;
    let mut plc = Plc::connect(cell.address).await;
    plc.write(COUNTER, &[7, HOME]).await.unwrap();
    plc.write(COUNTER, &[8, HOME]).await.unwrap();
    let seen = plc.seen().await;
    assert_eq!((seen.counter, seen.status & (PREPARED | READY | BUSY | DONE)), (0, 0), "{seen:?}");
    plc.write(COUNTER, &[8, NONE]).await.unwrap();
    let seen = plc.seen().await;
    assert_eq!((seen.counter, seen.status & (PREPARED | READY)), (8, PREPARED | READY), "{seen:?}");
    assert_eq!(cell.proxy.frames.motions(), 0);
}

#[tokio::test]
async fn wrong_values_are_exception_3_and_move_nothing() {
    let (cell, mut plc) = Cell::homed().await;
    let motions = cell.proxy.frames.motions();
    let wrong = [
        (MOVE, Values::at(30_000, 1000), OUT_OF_RANGE),
        (MOVE, Values::at(2000, 60_000), OUT_OF_RANGE),
        (GRIP, Values { force: 60_000, ..Values::at(2000, 1000) }, OUT_OF_RANGE),
        (GRIP, recipe(99), NOT_FOUND),
        (GRIP, recipe(256), OUT_OF_RANGE),
        (TAKE_LEASE, Values { on_loss: 9, ..Values::default() }, OUT_OF_RANGE),
        (42, Values::default(), OUT_OF_RANGE),
    ];
    let mut exceptions = 0;
    for (command, values, problem) in wrong {
        // On a busy machine, the refusal can be later than the response.
        let answer = plc.command(command, values).await;
        assert!(matches!(answer, Ok(()) | Err(ExceptionCode::IllegalDataValue)), "{command}: {answer:?}");
        exceptions += u32::from(answer.is_err());
        let seen = plc.until("refused", |seen| seen.status & DONE != 0).await;
        assert_eq!((seen.problem, seen.status & (DONE | OK | NOK)), (problem, DONE | NOK), "{seen:?}");
        assert_eq!((seen.counter, seen.outcome), (plc.counter, 0));
    }
    assert!(exceptions >= 3, "{exceptions}: what the registers themselves show is refused at once");
    assert_eq!(cell.proxy.frames.motions(), motions);
}

#[tokio::test]
async fn stop_ends_a_motion() {
    let (_cell, mut plc) = Cell::homed().await;
    plc.command(MOVE, Values::at(2500, 50)).await.unwrap();
    let moving = plc.until("moving", |seen| seen.status & MOVING != 0).await;
    assert_eq!(moving.status & (BUSY | READY | DONE), BUSY, "{moving:?}");
    plc.ok(STOP, Values::default()).await;
    plc.until("standing", |seen| seen.status & MOVING == 0).await;
}

#[tokio::test]
async fn lease_is_taken_by_the_first_motion_and_released() {
    let (cell, mut plc) = Cell::homed().await;
    assert_eq!(plc.seen().await.status & (MINE | OTHERS), MINE);
    assert_eq!(cell.gateway.state().await["lease_holder"], "modbus:127.0.0.1");
    let name: Vec<u8> = plc.inputs(116, 16).await.into_iter().flat_map(u16::to_be_bytes).collect();
    assert_eq!(std::str::from_utf8(&name).unwrap().trim_end_matches('\0'), "modbus:127.0.0.1");
    let motion = json!({"width_mm": 30, "speed_mm_s": 100});
    cell.gateway.post("move", &motion).await.problem(409, "lease_held");
    plc.ok(RELEASE_LEASE, Values::default()).await;
    assert_eq!(plc.seen().await.status & (MINE | OTHERS), 0);
    until_free(&cell.gateway).await;

    let lease = cell.gateway.post("lease", &json!({"holder": "mes", "ttl_ms": 60000})).await.text("token");
    let refused = plc.ended(MOVE, Values::at(3000, 1000)).await;
    assert_eq!((refused.problem, refused.outcome, refused.status & (NOK | OTHERS)), (LEASE_HELD, 0, NOK | OTHERS));
    cell.gateway.send(cell.gateway.request("DELETE", "lease").header("Wsg-Lease", &lease)).await.ok();
    plc.ok(MOVE, Values::at(3000, 1000)).await;
    plc.ok(TAKE_LEASE, Values { on_loss: 0x13, ..Values::default() }).await;
    let lease = cell.gateway.get("lease").await.ok();
    assert_eq!((&lease["on_loss_moving"], &lease["on_loss_holding"]), (&json!("finish"), &json!("keep")));
}

#[tokio::test]
async fn fast_stop_is_acknowledged_by_its_number() {
    let (cell, mut plc) = Cell::homed().await;
    plc.command(MOVE, Values::at(2500, 50)).await.unwrap();
    plc.until("moving", |seen| seen.status & MOVING != 0).await;
    plc.write(FAST_STOP_REGISTER, &[1]).await.unwrap();
    let stopped = plc.until("latched", |seen| seen.status & (LATCHED | BUSY) == LATCHED).await;
    assert_eq!((stopped.outcome, stopped.fault), (ABORTED, 10), "{stopped:?}");
    assert!(cell.proxy.frames.count(FAST_STOP) > 0);
    let number = stopped.fast_stop_number;
    let acknowledge = |number| Values { fast_stop_number: number, ..Values::default() };
    for (command, values) in [(ACKNOWLEDGE, acknowledge(number)), (MOVE, Values::at(3000, 1000))] {
        let pressed = plc.ended(command, values).await;
        let still = (pressed.problem, pressed.status & (NOK | LATCHED));
        assert_eq!(still, (FAST_STOP_LATCHED, NOK | LATCHED), "still requested");
    }
    plc.write(FAST_STOP_REGISTER, &[0]).await.unwrap();
    let newer = cell.gateway.post("fast-stop", &json!({})).await.ok();
    assert_eq!(newer["fast_stop_confirmed"], true);
    let stale = plc.ended(ACKNOWLEDGE, acknowledge(number)).await;
    assert_eq!((stale.problem, stale.status & (NOK | LATCHED)), (STALE_FAST_STOP, NOK | LATCHED), "{stale:?}");
    assert_ne!(stale.fast_stop_number, number);
    let refused = plc.ended(MOVE, Values::at(3000, 1000)).await;
    assert_eq!(refused.problem, FAST_STOP_LATCHED);
    let cleared = plc.ok(ACKNOWLEDGE, acknowledge(stale.fast_stop_number)).await;
    assert_eq!((cleared.fast_stop_number, cleared.fault), (0, 0), "{cleared:?}");
    plc.ok(MOVE, Values::at(3000, 1000)).await;
}

#[tokio::test]
async fn one_request_writes_a_command_and_reads_the_status() {
    let cell = Cell::start().await;
    let mut plc = Plc::ready(cell.address).await;
    let read = plc.client.read_write_multiple_registers(1100, 2, COUNTER, &[1, HOME]).await.unwrap().unwrap();
    assert_eq!((read[0], read[1] & (BUSY | DONE)), (1, BUSY));
    let homed = plc.until("homed", |seen| seen.status & DONE != 0).await;
    assert_eq!((homed.outcome, homed.status & OK), (SUCCESS, OK));
    plc.client.write_single_register(COUNTER + 1, STOP).await.unwrap().unwrap();
    assert_eq!(plc.client.read_holding_registers(COUNTER, 2).await.unwrap().unwrap(), [1, STOP]);
    assert_eq!(plc.seen().await.counter, 1, "the counter has not changed");
}
