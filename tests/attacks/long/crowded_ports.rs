//! The crowds of `every_run::crowded_ports`, larger than the bounds of Modbus and the WSG port.

use crate::attack::Wanted;
use crate::every_run::{attacked, modbus, other_port};

const WANTED: Wanted = Wanted { http: 60, others: 60 };

/// More than are admitted, so that connections are evicted all the time.
const IDLE: usize = 600;
const BUSY: usize = 560;
const FLOODING: usize = 120;

#[test]
fn excess_idle_modbus_connections_block_no_client() {
    attacked("idle", IDLE, WANTED, modbus).answers_every_client();
}

#[test]
fn excess_idle_port_connections_block_no_client() {
    attacked("idle", IDLE, WANTED, |gateway| gateway.port).answers_every_client();
}

/// From another address: the connections of one address make room for each other.
#[test]
fn excess_busy_modbus_connections_block_no_client() {
    attacked("cyclic_reads@127.0.0.2", BUSY, WANTED, modbus).answers_every_client();
}

#[test]
fn many_modbus_stops_of_another_gripper_block_no_client() {
    attacked("modbus_stops", FLOODING, WANTED, modbus).answers_every_client();
}

#[test]
fn many_port_stops_of_another_gripper_block_no_client() {
    attacked("port_stops", FLOODING, WANTED, other_port).answers_every_client();
}
