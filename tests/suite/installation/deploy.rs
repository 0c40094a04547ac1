//! Files in `deploy/`.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::json;

use crate::harness::{Gateway, JournalFile};

/// The program, and keys of its configuration, which are named like metrics.
const OTHER_NAMES: &[&str] = &[
    "wsg_base",
    "wsg_gateway",
    "wsg_gateway_ros",
    "wsg_port",
    "wsg_port_allow",
    "wsg_port_acknowledge",
    "wsg_port_checksum_evaluation",
    "wsg_port_limits",
    "wsg_port_max_force_n",
    "wsg_tool",
];

/// Metrics named in a text.
fn named(text: &str) -> BTreeSet<&str> {
    let words = text.split(|character: char| !character.is_ascii_alphanumeric() && character != '_');
    words.filter(|word| word.starts_with("wsg_") && !OTHER_NAMES.contains(word)).collect()
}

/// All texts below a directory, without those for ROS 2, whose links and packages have such names.
fn texts(directory: &Path) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.ends_with("ros2") {
            continue;
        }
        if path.is_dir() {
            found.extend(texts(&path));
        } else if let Ok(text) = std::fs::read_to_string(&path) {
            found.push((path.display().to_string(), text));
        }
    }
    found
}

#[tokio::test]
async fn monitored_metrics_exist() {
    let journal = JournalFile::new();
    let gateway = Gateway::with_webhook(&[
        "--gripper",
        "g=sim://wsg50",
        "--wsg-port",
        "g=127.0.0.1:0",
        "--journal",
        &journal.path(),
    ])
    .await;
    gateway.post("lease", &json!({"ttl_ms": 60_000})).await.ok();
    let figures = gateway.figures().await;
    let series: BTreeSet<_> = figures.keys().flat_map(|series| named(series)).collect();
    let histograms = series.iter().filter_map(|name| name.strip_suffix("_bucket"));
    let metrics: BTreeSet<_> = series.iter().copied().chain(histograms).collect();

    // Without a token or a certificate that ends, these have no samples.
    let of_credentials = ["wsg_token_expiry_timestamp_seconds", "wsg_certificate_expiry_timestamp_seconds"];
    let metrics: BTreeSet<_> = metrics.into_iter().chain(of_credentials).collect();
    let texts = texts(&Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy"));
    for (path, text) in &texts {
        let unknown: Vec<_> = named(text).difference(&metrics).copied().collect();
        assert!(unknown.is_empty(), "{path}: unknown metrics {unknown:?}; the gateway has {metrics:#?}");
    }
    let watched: BTreeSet<_> = texts.iter().flat_map(|(_, text)| named(text)).collect();
    for needed in ["wsg_link_up", "wsg_journal_up", "wsg_fast_stop_latched", "wsg_checksum_errors_total"] {
        assert!(watched.contains(needed), "no alert or panel uses {needed}");
    }
}

/// ModemManager sends AT commands to new serial ports.
#[test]
fn udev_rule_keeps_modem_manager_from_adapters() {
    let rules = include_str!("../../../deploy/udev/60-wsg-gateway.rules");
    let rule = rules.lines().find(|line| line.contains("ID_MM_DEVICE_IGNORE")).unwrap();
    assert!(rule.starts_with("ACTION!=\"remove\", SUBSYSTEM==\"tty\", DRIVERS==\""), "{rule}");
    assert!(rule.contains("ENV{ID_MM_DEVICE_IGNORE}=\"1\", ENV{ID_MM_PORT_IGNORE}=\"1\""), "{rule}");
    for driver in ["ftdi_sio", "pl2303", "cp210x", "ch341", "cdc_acm"] {
        assert!(rule.contains(driver), "{rule}");
    }
}
