//! Fuzzes the target that the environment variable `TARGET` names.

#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use wsg_gateway::fuzz::{TARGETS, Target};

fn target() -> Target {
    let wanted = std::env::var("TARGET").expect("TARGET names a target");
    let named = TARGETS.iter().find(|(name, _)| *name == wanted);
    named.unwrap_or_else(|| panic!("no target {wanted:?}: {TARGETS:?}")).1
}

fuzz_target!(|data: &[u8]| {
    static TARGET: LazyLock<Target> = LazyLock::new(target);
    TARGET(data);
});
