//! The table of topics in the guide: made anew from the operations, and compared.
//! `WSG_TEST_WRITE=1 cargo test --lib documents` writes it.

use std::fmt::Write as _;
use std::path::Path;

use strum::VariantArray as _;

use super::requests::offered;
use super::topics::{COMMAND, FAST_STOP};
use crate::access::Role;
use crate::operations::Operation;

const GUIDE: &str = "deploy/guide/mqtt.md";
const HEADING: &str = "| topic below the prefix | operation | roles |\n| --- | --- | --- |\n";

fn row(operation: &Operation) -> String {
    let Operation { name, verb, path, .. } = operation;
    let gripper = if operation.is_of_gripper() { "GRIPPER/" } else { "" };
    let topic = if *name == FAST_STOP { format!("{gripper}{name}") } else { format!("{gripper}{COMMAND}/{name}") };
    let path = path.replacen("/grippers/{gripper}", "…", 1).replace(['{', '}'], "");
    let roles = Role::VARIANTS.iter().filter(|role| role.has(operation.right));
    let roles: Vec<_> = roles.map(ToString::to_string).collect();
    let roles = if roles.len() == Role::VARIANTS.len() { "all".to_owned() } else { roles.join(", ") };
    format!("| `{topic}` | `{verb} {path}` | {roles} |\n")
}

#[test]
fn topics_in_the_guide_are_current() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(GUIDE);
    let guide = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = guide.split_once(HEADING).unwrap();
    let (_, after) = rest.split_once("\n\n").unwrap();
    let mut made = format!("{before}{HEADING}");
    for operation in offered() {
        made.push_str(&row(operation));
    }
    write!(made, "\n{after}").unwrap();
    if std::env::var_os("WSG_TEST_WRITE").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    assert!(guide == made, "{GUIDE} is stale: WSG_TEST_WRITE=1 cargo test --lib documents");
}
