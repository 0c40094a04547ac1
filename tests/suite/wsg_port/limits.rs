//! Limits of the gripper that clients of the WSG port may change.

use serde_json::json;

use super::{ACCESS_DENIED, SUCCESS, configured, connect};
use crate::harness::wsg::floats;
use crate::harness::{Gateway, run};

const FORCE_LIMIT: u8 = 0x32;
const SET_SOFT_LIMITS: u8 = 0x34;
const CLEAR_SOFT_LIMITS: u8 = 0x36;
const OVERDRIVE: u8 = 0x37;

async fn with(keys: &str) -> Gateway {
    configured(&format!("[grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = \"127.0.0.1:0\"\n{keys}")).await
}

#[tokio::test]
async fn fixed_limits_cannot_be_changed() {
    let gateway = with("wsg_port_limits = \"fixed\"\n").await;
    let mut driver = connect(&gateway).await;
    for (id, parameters) in [
        (FORCE_LIMIT, floats(&[10.0])),
        (SET_SOFT_LIMITS, floats(&[10.0, 60.0])),
        (CLEAR_SOFT_LIMITS, vec![]),
        (OVERDRIVE, vec![1]),
    ] {
        assert_eq!(driver.status(id, &parameters).await, ACCESS_DENIED, "{id:02X}h");
    }
    assert_eq!(driver.status(OVERDRIVE, &[0]).await, SUCCESS, "switching Overdrive Mode off lowers a limit");
    assert_eq!(driver.status(0x33, &[]).await, SUCCESS);
    assert_eq!(driver.status(0x30, &floats(&[2000.0])).await, SUCCESS, "an acceleration is no limit");
    gateway.until_logged("wsg_port_limits").await;
    gateway.put("settings/force-limit", &json!({"force_n": 60})).await.ok();
}

#[tokio::test]
async fn force_limit_is_allowed_up_to_the_configured_one() {
    let gateway = with("wsg_port_limits = \"fixed\"\nwsg_port_max_force_n = 40.3\n").await;
    let mut driver = connect(&gateway).await;
    assert_eq!(driver.status(FORCE_LIMIT, &floats(&[40.3])).await, SUCCESS);
    assert_eq!(driver.status(FORCE_LIMIT, &floats(&[40.4])).await, ACCESS_DENIED);
    assert_eq!(driver.ask(0x33, &[]).await.data, floats(&[40.3]));
    assert_eq!(driver.status(FORCE_LIMIT, &floats(&[20.0])).await, SUCCESS);
    assert_eq!(driver.status(OVERDRIVE, &[1]).await, ACCESS_DENIED);
}

#[tokio::test]
async fn all_limits_can_be_changed_by_default() {
    let gateway = with("").await;
    let mut driver = connect(&gateway).await;
    for (id, parameters) in [
        (OVERDRIVE, vec![1]),
        (FORCE_LIMIT, floats(&[100.0])),
        (SET_SOFT_LIMITS, floats(&[10.0, 60.0])),
        (CLEAR_SOFT_LIMITS, vec![]),
    ] {
        assert_eq!(driver.status(id, &parameters).await, SUCCESS, "{id:02X}h");
    }
}

#[tokio::test]
async fn check_names_wrong_limits() {
    let check = async |keys: &str| {
        let files = crate::harness::Directory::new();
        let text = format!("[grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = \"127.0.0.1:0\"\n{keys}");
        run(&["check", "--config", &files.write("gateway.toml", &text)]).await
    };
    for (keys, parts) in [
        ("wsg_port_max_force_n = 40\n", ["wsg_port_max_force_n has no effect", "wsg_port_limits = \"fixed\"", ":4"]),
        ("wsg_port_limits = \"fixed\"\nwsg_port_max_force_n = 0\n", ["must be a force in N above 0", "is 0", ":5"]),
        ("wsg_port_limits = \"closed\"\n", ["open", "fixed", ":4"]),
    ] {
        let ended = check(keys).await;
        assert!(!ended.status.success(), "{keys}: {ended:?}");
        for part in parts {
            assert!(ended.stderr.contains(part), "{part}: {}", ended.stderr);
        }
    }
    let good = check("wsg_port_limits = \"fixed\"\nwsg_port_max_force_n = 40\n").await;
    assert!(good.status.success(), "{good:?}");
}
