//! `/metrics` and `/readyz`.

#![allow(clippy::float_cmp, reason = "counts are whole")]

use std::collections::BTreeMap;

use serde_json::json;

use crate::harness::{Gateway, Proxy, Simulator, eventually};

/// Value of this series.
#[track_caller]
fn of(figures: &BTreeMap<String, f64>, series: &str) -> f64 {
    *figures.get(series).unwrap_or_else(|| panic!("no {series} among {figures:#?}"))
}

/// Series of this name for gripper `g`, with further labels.
fn g(name: &str, labels: &str) -> String {
    format!("{name}{{gripper=\"g\"{labels}}}")
}

#[tokio::test]
async fn metrics_count_commands_and_stops() {
    let device = Simulator::with_part().await;
    let gateway = Gateway::homed_at(device.address).await;
    let figures = gateway.figures().await;
    let (age, temperature) = (g("wsg_update_age_seconds", ""), g("wsg_temperature_celsius", ""));
    assert!(of(&figures, &age) < 1.0 && of(&figures, &temperature) > 0.0, "{figures:#?}");
    // These series exist at 0, so that the first occurrence is an increase.
    for series in [
        g("wsg_fast_stop_latched", ""),
        g("wsg_fast_stop_unconfirmed", ""),
        g("wsg_lease_held", ""),
        g("wsg_state_code", ""),
        g("wsg_commands_total", ",kind=\"grip\",outcome=\"NO_PART\""),
        "wsg_fast_stops_total{cause=\"requested\",gripper=\"g\"}".to_owned(),
    ] {
        assert_eq!(of(&figures, &series), 0.0, "{series}");
    }
    let lease = gateway.post("lease", &json!({"holder": "plc7", "ttl_ms": 60_000})).await;
    let figures = gateway.figures().await;
    assert_eq!(of(&figures, &g("wsg_lease_held", "")), 1.0);
    assert_eq!(of(&figures, &g("wsg_lease_holder_info", ",holder=\"plc7\"")), 1.0);
    let token = lease.text("token");
    gateway.send(gateway.request("DELETE", "lease").header("Wsg-Lease", token)).await.ok();

    let grip = json!({"width_mm": 20, "speed_mm_s": 50, "force_n": 30});
    gateway.post("grip", &grip).await.outcome("PART_HELD");
    gateway.post("fast-stop", &json!({})).await.ok();
    gateway.post("grip", &grip).await.problem(409, "fast_stop");

    let figures = gateway.figures().await;
    let (width_m, force_n) = (of(&figures, &g("wsg_width_meters", "")), of(&figures, &g("wsg_force_newtons", "")));
    assert!(width_m > 0.015 && width_m < 0.025 && force_n >= 0.0, "{width_m} m, {force_n} N");
    for (series, expected) in [
        (g("wsg_link_up", ""), 1.0),
        (g("wsg_fast_stop_latched", ""), 1.0),
        (g("wsg_reconnects_total", ""), 0.0),
        (g("wsg_checksum_errors_total", ""), 0.0),
        (g("wsg_resynchronisations_total", ""), 0.0),
        (g("wsg_parts_lost_total", ""), 0.0),
        (g("wsg_commands_total", ",kind=\"home\",outcome=\"SUCCESS\""), 1.0),
        (g("wsg_commands_total", ",kind=\"grip\",outcome=\"PART_HELD\""), 1.0),
        (g("wsg_motion_duration_seconds_count", ",kind=\"home\""), 1.0),
        (g("wsg_motion_duration_seconds_count", ",kind=\"grip\""), 1.0),
        ("wsg_fast_stops_total{cause=\"requested\",gripper=\"g\"}".to_owned(), 1.0),
        (g("wsg_fast_stop_sent_seconds_count", ""), 1.0),
        (g("wsg_fast_stop_confirmed_seconds_count", ""), 1.0),
        (g("wsg_fast_stop_confirmed_seconds_bucket", ",le=\"+Inf\""), 1.0),
        ("wsg_clients_connected{door=\"http\"}".to_owned(), 1.0),
        ("wsg_updates_dropped_total{door=\"http\"}".to_owned(), 0.0),
        ("wsg_journal_up".to_owned(), 1.0),
        ("wsg_journal_damaged".to_owned(), 0.0),
        ("wsg_journal_restored".to_owned(), 0.0),
        ("wsg_clock_doubtful".to_owned(), 0.0),
        ("wsg_journal_records_lost_total".to_owned(), 0.0),
    ] {
        assert_eq!(of(&figures, &series), expected, "{series}");
    }
    let route = "route=\"/api/v1/grippers/{gripper}/grip\"";
    for status in [200, 409] {
        let series = format!("wsg_requests_total{{door=\"http\",method=\"POST\",{route},status=\"{status}\"}}");
        assert_eq!(of(&figures, &series), 1.0, "{series}");
    }
    let sent = of(&figures, &g("wsg_fast_stop_sent_seconds_sum", ""));
    let confirmed = of(&figures, &g("wsg_fast_stop_confirmed_seconds_sum", ""));
    assert!(sent <= confirmed && confirmed > 0.0, "{sent} s until it was sent, {confirmed} s until it was confirmed");
    // Seconds, not milliseconds.
    let homing = of(&figures, &g("wsg_motion_duration_seconds_sum", ",kind=\"home\""));
    assert!(homing > 0.05 && homing < 60.0, "{homing}");
    for series in [
        g("wsg_updates_total", ""),
        g("wsg_round_trip_seconds_count", ""),
        "wsg_frames_total{direction=\"sent\",gripper=\"g\"}".to_owned(),
        "wsg_frames_total{direction=\"received\",gripper=\"g\"}".to_owned(),
        "process_start_time_seconds".to_owned(),
        "process_resident_memory_bytes".to_owned(),
        "process_open_fds".to_owned(),
    ] {
        assert!(of(&figures, &series) > 0.0, "{series}");
    }
    for direction in ["sent", "received"] {
        let frames = of(&figures, &format!("wsg_frames_total{{direction=\"{direction}\",gripper=\"g\"}}"));
        let bytes = of(&figures, &format!("wsg_bytes_total{{direction=\"{direction}\",gripper=\"g\"}}"));
        // The shortest frame has 8 bytes.
        assert!(bytes >= 8.0 * frames, "{direction}: {bytes} bytes are {frames} frames");
    }
}

#[tokio::test]
async fn readiness_follows_the_device_and_reconnects_are_counted() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::refusing(device.address);
    let gateway = Gateway::of(proxy.address).await;
    // Nothing listens at the device's address yet.
    let not_ready = gateway.get("/readyz").await;
    assert_eq!((not_ready.status, not_ready.field("ready")), (503, &json!(false)), "{not_ready:?}");
    let named = |body: &serde_json::Value| body["not_ready"][0].as_str().is_some_and(|name| name.starts_with("g: "));
    assert!(named(&not_ready.body) && not_ready.field("journal_cause").is_null(), "{not_ready:?}");
    assert_eq!(of(&gateway.figures().await, &g("wsg_link_up", "")), 0.0);
    assert_eq!(gateway.get("/healthz").await.ok()["status"], "ok");

    proxy.accept();
    let ready =
        eventually("the gateway is ready", async || Some(gateway.get("/readyz").await).filter(|it| it.status == 200));
    assert_eq!(
        ready.await.body,
        json!({"gateway": "gateway", "ready": true, "journal_cause": null, "journal_damage": null, "journal_restored": null, "zenoh_cause": null, "not_ready": [], "warnings": [],
            "version": env!("CARGO_PKG_VERSION")})
    );
    let figures = gateway.figures().await;
    assert_eq!((of(&figures, &g("wsg_link_up", "")), of(&figures, &g("wsg_reconnects_total", ""))), (1.0, 0.0));

    proxy.go_away().await;
    let lost = eventually("the gateway is not ready", async || {
        Some(gateway.get("/readyz").await).filter(|it| it.status == 503)
    })
    .await;
    assert!(named(&lost.body), "{lost:?}");
    proxy.accept();
    gateway.until_link("connected").await;
    assert_eq!(of(&gateway.figures().await, &g("wsg_reconnects_total", "")), 1.0);
}
