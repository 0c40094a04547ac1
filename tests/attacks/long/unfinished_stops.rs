//! FAST STOPs whose bodies stay unfinished, with the time limit of 50 ms for all others. The attackers open 20,000
//! connections per second, so on two cores the time depends on what the machine leaves to the gateway.

use crate::every_run::crowded_ports::attacked;
use crate::every_run::unfinished_stops::{UNFINISHED, WANTED};

#[test]
fn unfinished_stops_block_no_client() {
    attacked("half_sent_stops", UNFINISHED, WANTED, |gateway| gateway.address).answers_every_client();
}

#[test]
fn unfinished_stops_of_another_address_block_no_client() {
    attacked("half_sent_stops@127.0.0.2", UNFINISHED, WANTED, |gateway| gateway.address).answers_every_client();
}
