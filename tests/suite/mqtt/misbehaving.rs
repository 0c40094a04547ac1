//! Brokers that misbehave: motions and FAST STOPs go on, and the cause is told.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::json;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;

use super::broker::{Broker, Mood};
use super::{configuration, homed};
use crate::harness::{Directory, Gateway, eventually, shortest};

/// Time for a FAST STOP whatever the broker does.
const STOPPED_WITHIN: Duration = Duration::from_millis(200);

async fn stops_at_once(gateway: &Gateway) {
    gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 200})).await.outcome("SUCCESS");
    let took = shortest(STOPPED_WITHIN, async || {
        let begin = Instant::now();
        let stop = gateway.post("fast-stop", &json!({})).await.ok();
        let took = begin.elapsed();
        gateway.post("acknowledge", &json!({"fast_stop_id": stop["fast_stop_id"]})).await.ok();
        took
    })
    .await;
    assert!(took <= STOPPED_WITHIN, "{took:?}");
}

#[tokio::test]
async fn silent_broker_delays_neither_motions_nor_fast_stops() {
    let broker = Broker::start().await;
    broker.set(Mood::Silent);
    let gateway = homed(&broker, &[], "commands = true\nfast_stop = true").await;
    stops_at_once(&gateway).await;
    let connected = gateway.figures().await;
    assert!(connected["wsg_mqtt_connected{connection=\"fast_stops\"}"] < 1.0, "{connected:?}");
    let begin = Instant::now();
    assert!(gateway.terminate().await.status.success());
    assert!(begin.elapsed() < Duration::from_secs(5), "{:?}", begin.elapsed());
}

#[tokio::test]
async fn broker_without_acknowledgements_keeps_few_records_waiting() {
    let broker = Broker::start().await;
    broker.set(Mood::Unacknowledging);
    let gateway = homed(&broker, &[], "").await;
    stops_at_once(&gateway).await;
    for width in 30..50 {
        gateway.post("move", &json!({"width_mm": width, "speed_mm_s": 200})).await.outcome("SUCCESS");
    }
    // Two records of each motion, of which the broker has got the first.
    let waiting = async || (gateway.figures().await["wsg_mqtt_waiting_events"] > 30.0).then_some(());
    eventually("the records wait", waiting).await;
    assert!(broker.all("plant/cell/+/events").len() <= 40);
}

#[tokio::test]
async fn refusals_are_told_with_their_remedy() {
    let broker = Broker::start().await;
    broker.set(Mood::Closed);
    let gateway = homed(&broker, &[], "").await;
    stops_at_once(&gateway).await;
    eventually("failures", async || {
        (gateway.figures().await["wsg_mqtt_failures_total{connection=\"publications\"}"] > 1.0).then_some(())
    })
    .await;
    broker.set(Mood::Refusing);
    broker.until("plant/cell/availability", |_| true).await;
    let ended = gateway.terminate().await;
    assert!(ended.stderr.contains("MQTT connection failed; retrying"), "{}", ended.stderr);
    assert!(ended.stderr.contains("check user, password_file and certificate"), "{}", ended.stderr);

    let gateway = homed(&broker, &[], "").await;
    eventually("a refused message", async || {
        (gateway.figures().await["wsg_mqtt_failures_total{connection=\"publications\"}"] > 0.0).then_some(())
    })
    .await;
    let ended = gateway.terminate().await;
    assert!(ended.stderr.contains("allow the gateway's user to publish to all topics"), "{}", ended.stderr);
}

/// Returns a certificate for localhost, and the server's part of TLS with it.
fn certified() -> (String, TlsAcceptor) {
    let signed = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let key = PrivateKeyDer::try_from(signed.signing_key.serialize_der()).unwrap();
    let config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_no_client_auth()
        .with_single_cert(vec![signed.cert.der().clone()], key)
        .unwrap();
    (signed.cert.pem(), TlsAcceptor::from(Arc::new(config)))
}

#[tokio::test]
async fn broker_is_known_by_its_certificate() {
    let (certificate, acceptor) = certified();
    let broker = Broker::with_tls(Some(acceptor)).await;
    let files = Directory::new();
    let password = files.write("password", "s3cret\n");
    let url = format!("mqtts://localhost:{}", broker.address.port());
    let with_ca = |certificate: &str, name: &str| {
        let ca = files.write(name, certificate);
        let lines = format!("ca_file = {ca:?}\nuser = \"cell-7\"\npassword_file = {password:?}");
        configuration(&broker, &lines).replace(&format!("mqtt://{}", broker.address), &url)
    };
    let gateway = Gateway::with_file(&[], &with_ca(&certified().0, "other.pem")).await;
    eventually("a failed handshake", async || {
        (gateway.figures().await["wsg_mqtt_failures_total{connection=\"publications\"}"] > 0.0).then_some(())
    })
    .await;
    let ended = gateway.terminate().await;
    assert!(ended.stderr.contains("TLS failed") && ended.stderr.contains("ca_file"), "{}", ended.stderr);
    assert!(broker.logins().is_empty() && !ended.stderr.contains("s3cret"));

    let gateway = Gateway::with_file(&[], &with_ca(&certificate, "ca.pem")).await;
    broker.until("plant/cell/availability", |got| got.text == "online").await;
    let login = broker.logins()[0].clone().unwrap();
    assert_eq!((login.username.as_str(), login.password.as_str()), ("cell-7", "s3cret"));
    let ended = gateway.terminate().await;
    assert!(!ended.stderr.contains("s3cret") && !ended.stdout.contains("s3cret"), "{}", ended.stderr);
}
