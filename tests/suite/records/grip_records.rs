//! Grip records: the curve shows the approach, the contact and the force, as the simulated device produced them.

use serde::Deserialize;
use serde_json::json;
use wsg_gateway::sim::Part;

use crate::harness::{Gateway, Simulator, eventually};

const SPEED_MM_S: f64 = 50.0;
const FORCE_N: f64 = 80.0;

/// Rounding of the stored values.
const ROUNDING_N: f64 = 0.5;
const ROUNDING_MM: f64 = 0.01;

/// Allowed delay of an update on a busy machine.
const DELAY_MS: f64 = 100.0;

/// A line of the CSV.
#[derive(Debug, Deserialize)]
struct Sample {
    t_ms: f64,
    width_mm: f64,
    speed_mm_s: f64,
    force_n: f64,
}

#[tokio::test]
async fn grip_curve_shows_approach_contact_and_force() {
    let part = Part::outside(20.0);
    let device = Simulator::with_part().await;
    let gateway = Gateway::homed_at(device.address).await;
    gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
    let lease = gateway.post("lease", &json!({"holder": "cell plc"})).await.ok()["token"].clone();
    let grip = json!({"width_mm": part.width_mm, "speed_mm_s": SPEED_MM_S, "force_n": FORCE_N, "lease": lease,
        "request_id": "order 7"});
    let held = gateway.post("grip", &grip).await.outcome("PART_HELD");
    let path = format!("/api/v1/grips/{}", held["id"].as_str().unwrap());
    let record =
        eventually("the grip record", async || Some(gateway.get(&path).await).filter(|answer| answer.status == 200));
    let record = record.await.ok();
    let info = gateway.get("/api/v1/grippers/g").await.ok();
    let device = (&record["gateway"], &record["serial_number"]);
    assert_eq!(device, (&json!("gateway"), &info["serial_number"]), "{record}");
    let done = gateway.events("kind=command&order=newest", 6).await.remove(0);
    for record in [&record, &done] {
        let requested = json!({
            "holder": "cell plc", "request_id": "order 7", "requested_width_mm": part.width_mm,
            "requested_speed_mm_s": SPEED_MM_S, "requested_force_n": FORCE_N,
        });
        for (name, value) in requested.as_object().unwrap() {
            assert_eq!(&record[name], value, "{name} in {record}");
        }
    }
    let csv = gateway.request("GET", &format!("{path}/curve")).header("Accept", "text/csv");
    let csv = gateway.send(csv).await.ok();
    let samples = csv::Reader::from_reader(csv.as_str().unwrap().as_bytes());
    let samples: Vec<Sample> = samples.into_deserialize().collect::<Result<_, _>>().unwrap();
    assert_eq!(record["samples"], json!(samples.len()));
    assert!(samples.is_sorted_by_key(|sample| sample.t_ms), "{samples:?}");

    let contact = samples.iter().position(|sample| sample.width_mm < part.width_mm).expect("the part is touched");
    let (way, pressing) = samples.split_at(contact);
    // On the approach the force is zero, and after the start the speed is the requested one.
    assert!(way.iter().all(|sample| sample.force_n.abs() <= ROUNDING_N), "{way:?}");
    let (begun, met) = (way.iter().position(|sample| sample.width_mm < 39.0).unwrap(), &pressing[0]);
    let steady = &way[begun..];
    assert!(steady.len() > 20, "{way:?}");
    assert!(steady.iter().all(|sample| (sample.speed_mm_s + SPEED_MM_S).abs() < 0.5), "{steady:?}");
    let expected_ms = (steady[0].width_mm - met.width_mm) / SPEED_MM_S * 1000.0;
    assert!((met.t_ms - steady[0].t_ms - expected_ms).abs() < DELAY_MS, "{steady:?} {met:?}");

    // After contact, the part is compressed according to its stiffness until the force is reached and held.
    let deepest_mm = FORCE_N / part.stiffness_n_mm;
    for sample in pressing {
        let depth_mm = part.width_mm - sample.width_mm;
        assert!((0.0..=deepest_mm + ROUNDING_MM).contains(&depth_mm), "{sample:?}");
        assert!((sample.force_n - depth_mm * part.stiffness_n_mm).abs() <= ROUNDING_N, "{sample:?}");
    }
    assert!(pressing.is_sorted_by_key(|sample| sample.force_n), "{pressing:?}");
    let rising = pressing.iter().take_while(|sample| sample.force_n < FORCE_N - ROUNDING_N).count();
    assert!(rising > 1, "the rise has samples: {pressing:?}");
    let held_for_ms = samples[samples.len() - 1].t_ms - pressing[rising].t_ms;
    assert!(held_for_ms > 800.0, "the curve covers a second after the rise: {held_for_ms} ms");

    // The record agrees with the curve.
    let figure = |name: &str| record[name].as_f64().unwrap_or_else(|| panic!("no {name} in {record}"));
    assert!((figure("peak_force_n") - FORCE_N).abs() <= ROUNDING_N, "{record}");
    assert!((figure("contact_width_mm") - part.width_mm).abs() <= deepest_mm, "{record}");
    assert!((figure("time_to_contact_ms") - met.t_ms).abs() <= DELAY_MS, "{record} {met:?}");
    let at_contact = samples.iter().find(|sample| sample.t_ms >= figure("time_to_contact_ms")).unwrap();
    assert!((at_contact.width_mm - figure("contact_width_mm")).abs() <= ROUNDING_MM, "{at_contact:?} {record}");
}

/// A grip record of the CSV.
#[derive(Debug, Deserialize)]
struct Record {
    outcome: String,
    contact_width_mm: Option<f64>,
    force_n: Option<f64>,
    time_to_contact_ms: Option<f64>,
}

/// Returns mean and standard deviation of a sample, in two passes.
fn spread(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / (values.len() - 1) as f64).sqrt())
}

#[tokio::test]
async fn statistics_agree_with_the_records() {
    let device = Simulator::with_part().await;
    let gateway = Gateway::homed_at(device.address).await;
    let recipe = json!({"number": 1, "width_mm": 20, "speed_mm_s": 300, "accept_min_mm": 18, "accept_max_mm": 30});
    gateway.put("/api/v1/recipes/A", &recipe).await;
    for force_n in [20, 40, 60, 80] {
        gateway.post("grip", &json!({"recipe": 1, "force_n": force_n})).await.outcome("PART_HELD");
        gateway.post("release", &json!({"width_mm": 30, "speed_mm_s": 300})).await.outcome("SUCCESS");
    }
    let of_other = json!({"part_id": "B", "width_mm": 5, "speed_mm_s": 300});
    gateway.post("grip", &of_other).await.ok();
    let csv = eventually("the grip records", async || {
        let csv = gateway.get("/api/v1/grips.csv?part_id=A&order=oldest").await.ok();
        Some(csv.as_str().unwrap().to_owned()).filter(|csv| csv.lines().count() == 5)
    });
    let csv = csv.await;
    let records = csv::Reader::from_reader(csv.as_bytes()).into_deserialize();
    let records: Vec<Record> = records.collect::<Result<_, _>>().unwrap();
    let of_part = gateway.get("/api/v1/grips/statistics?part_id=A").await.ok();
    assert_eq!(of_part["count"], 4, "{of_part}");
    assert_eq!(of_part["outcomes"], json!([{"outcome": "PART_HELD", "count": 4, "rate": 1.0}]));
    assert!(records.iter().all(|record| record.outcome == "PART_HELD"));
    let column = |value: fn(&Record) -> Option<f64>| records.iter().filter_map(value).collect::<Vec<_>>();
    let columns = [
        ("contact_width_mm", column(|record| record.contact_width_mm)),
        ("force_n", column(|record| record.force_n)),
        ("time_to_contact_ms", column(|record| record.time_to_contact_ms)),
    ];
    let is = |figure: &serde_json::Value, expected: f64| (figure.as_f64().unwrap() - expected).abs() < 1e-9;
    for (name, values) in &columns {
        let (mean, deviation) = spread(values);
        let (min, max) = (values.iter().copied().reduce(f64::min), values.iter().copied().reduce(f64::max));
        let found = &of_part[name];
        let agrees = is(&found["mean"], mean) && is(&found["standard_deviation"], deviation);
        assert!(agrees && is(&found["min"], min.unwrap()) && is(&found["max"], max.unwrap()), "{name}: {of_part}");
    }
    let widths = &columns[0].1;
    let (mean, deviation) = spread(widths);
    assert!(is(&of_part["cpk"], (mean - 18.0) / (3.0 * deviation)), "{of_part}");
    let average = widths.iter().copied().reduce(|average, width| 0.8 * average + 0.2 * width).unwrap();
    assert!(is(&of_part["moving_average_mm"], average), "{of_part}");

    let newest = gateway.get("/api/v1/grips/statistics?part_id=A&window=2&gripper=g").await.ok();
    assert!(is(&newest["contact_width_mm"]["mean"], f64::midpoint(widths[2], widths[3])), "{newest}");
    let nothing = gateway.get("/api/v1/grips/statistics?gripper=h").await.ok();
    assert_eq!((&nothing["count"], &nothing["force_n"]["mean"]), (&json!(0), &json!(null)));
    for (query, field) in
        [("window=5", "window"), ("part_id=A&window=0", "window"), ("griper=g", "griper"), ("from=today", "from")]
    {
        let refused = gateway.get(&format!("/api/v1/grips/statistics?{query}")).await;
        assert!(refused.status == 400 || refused.status == 422, "{query}: {}", refused.body);
        assert_eq!(refused.body["field"], field, "{query}");
    }
}
