//! An unreachable device: clients get a status, and stay connected.

use super::{Cell, IO_ERROR, MOVE, SUCCESS};
use crate::harness::eventually;
use crate::harness::wsg::{PENDING, move_to};

const TIMEOUT: u16 = 7;

#[tokio::test]
async fn lost_link_is_a_status_and_keeps_clients_connected() {
    let mut cell = Cell::homed().await;
    let (mut driver, mut reader) = (cell.driver().await, cell.driver().await);
    assert_eq!(driver.status(MOVE, &move_to(5.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    cell.proxy.go_away().await;
    assert_eq!(driver.end_of(MOVE).await, TIMEOUT, "unknown outcome");
    cell.gateway.until_link("reconnecting").await;
    for client in [&mut driver, &mut reader] {
        for (id, parameters) in
            [(0x40, &[0; 3][..]), (0x43, &[0; 3]), (0x06, b"x"), (0x50, &[]), (0x24, b"ack"), (0x20, &[0])]
        {
            let status = client.status(id, parameters).await;
            // The actor checks the lease before the link.
            assert!(status == IO_ERROR || (status == super::ACCESS_DENIED && id == 0x20), "{id:02X}h: {status}");
        }
    }
    cell.proxy.accept();
    cell.gateway.until_link("connected").await;
    eventually("the device answers again", async || (reader.status(0x06, b"x").await == SUCCESS).then_some(())).await;
    assert_eq!(reader.status(0x41, &[0; 3]).await, SUCCESS);
}

#[tokio::test]
async fn updates_resume_after_a_lost_link() {
    let mut cell = Cell::homed().await;
    let mut reader = cell.driver().await;
    assert_eq!(reader.status(0x43, &[1, 20, 0]).await, SUCCESS);
    cell.proxy.go_away().await;
    cell.gateway.until_link("reconnecting").await;
    while reader.next_within(std::time::Duration::from_millis(200)).await.is_some() {}
    cell.proxy.accept();
    cell.gateway.until_link("connected").await;
    assert_eq!(reader.next().await.id, 0x43);
}

#[tokio::test]
async fn fast_stop_without_a_link_latches_unconfirmed() {
    let mut cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    cell.proxy.go_away().await;
    cell.gateway.until_link("reconnecting").await;
    assert_eq!(driver.status(0x23, &[]).await, TIMEOUT);
    let from = cell.proxy.frames.len();
    cell.proxy.accept();
    cell.gateway.until("confirmed", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(cell.proxy.frames.since(from)[0].id, 0x23, "FAST STOP is sent first");
    cell.gateway.until_link("connected").await;
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
}
