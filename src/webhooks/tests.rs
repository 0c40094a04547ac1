//! Webhooks between a journal and receivers on this machine.

use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use futures_util::FutureExt as _;
use jiff::SignedDuration;
use ring::hmac;
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::pki_types::PrivateKeyDer;

use super::*;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::{EventQuery, JournalLocation, Order, Recovered, Retention};
use crate::model::{Detail, Event, Link, LinkEvent};

const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";

/// A request that a receiver got.
#[derive(Debug)]
struct Got {
    head: String,
    headers: HashMap<String, String>,
    text: String,
    body: Value,
}

impl Got {
    fn id(&self) -> &str {
        &self.headers["webhook-id"]
    }

    fn seq(&self) -> i64 {
        self.body["seq"].as_i64().unwrap()
    }

    /// Asserts that the signature is right.
    fn assert_signed(&self) {
        let key = STANDARD.decode(SECRET.strip_prefix("whsec_").unwrap()).unwrap();
        let content = format!("{}.{}.{}", self.id(), self.headers["webhook-timestamp"], self.text);
        let tag = STANDARD.decode(self.headers["webhook-signature"].strip_prefix("v1,").unwrap()).unwrap();
        hmac::verify(&hmac::Key::new(hmac::HMAC_SHA256, &key), content.as_bytes(), &tag).unwrap();
    }
}

/// A receiver that answers from a script, and afterwards with 204.
struct TestReceiver {
    url: String,
    got: mpsc::Receiver<Got>,
}

impl TestReceiver {
    async fn start(answers: &[&str]) -> Self {
        Self::serve(answers, None).await
    }

    async fn serve(answers: &[&str], tls: Option<TlsAcceptor>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let scheme = if tls.is_some() { "https" } else { "http" };
        let url = format!("{scheme}://localhost:{}/hooks?key=s3cret", listener.local_addr().unwrap().port());
        let mut answers: VecDeque<String> = answers.iter().map(|answer| (*answer).to_owned()).collect();
        let (sender, got) = mpsc::channel(1024);
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                let mut answer = || answers.pop_front().unwrap_or_else(|| "204 No Content\r\n".to_owned());
                match &tls {
                    Some(tls) => {
                        if let Ok(stream) = tls.accept(stream).await {
                            let _ = sender.send(answered(stream, answer()).await).await;
                        }
                    }
                    None => drop(sender.send(answered(stream, answer()).await).await),
                }
            }
        });
        Self { url, got }
    }

    async fn next(&mut self) -> Got {
        self.got.recv().await.unwrap()
    }

    fn settings(&self) -> WebhookSettings {
        WebhookSettings {
            name: "mes".parse().unwrap(),
            receiver: self.url.parse().unwrap(),
            kinds: None,
            secret: SECRET.parse().unwrap(),
            authorities: Authorities::default(),
        }
    }
}

/// Reads a request and answers it.
async fn answered(mut stream: impl AsyncRead + AsyncWrite + Unpin, answer: String) -> Got {
    let mut bytes = Vec::new();
    let end = loop {
        assert!(stream.read_buf(&mut bytes).await.unwrap() > 0, "the request is cut short");
        if let Some(end) = bytes.windows(4).position(|window| window == b"\r\n\r\n") {
            break end + 4;
        }
    };
    let mut lines = std::str::from_utf8(&bytes[..end]).unwrap().lines();
    let head = lines.next().unwrap().to_owned();
    let headers: HashMap<_, _> = lines
        .filter_map(|line| line.split_once(": "))
        .map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned()))
        .collect();
    let length: usize = headers["content-length"].parse().unwrap();
    while bytes.len() < end + length {
        assert!(stream.read_buf(&mut bytes).await.unwrap() > 0, "the body is cut short");
    }
    let text = String::from_utf8(bytes.split_off(end)).unwrap();
    stream.write_all(format!("HTTP/1.1 {answer}\r\n").as_bytes()).await.unwrap();
    stream.shutdown().await.unwrap();
    Got { head, headers, body: serde_json::from_str(&text).unwrap(), text }
}

/// A journal file, removed after the test.
struct JournalFile(PathBuf);

impl JournalFile {
    fn new() -> Self {
        let path = std::env::temp_dir().join(format!("wsg-webhooks-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir(&path).unwrap();
        Self(path)
    }

    fn open(&self, retention: Retention) -> (Journal, Recovered) {
        Journal::open(JournalLocation::File(self.0.join("journal.db")), retention).unwrap()
    }
}

impl Drop for JournalFile {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

fn in_memory() -> (Journal, Recovered) {
    Journal::open(JournalLocation::Memory, Retention::default()).unwrap()
}

async fn record_at(journal: &Journal, at: Timestamp) {
    let (written, is_written) = oneshot::channel();
    let detail = Detail::Link(LinkEvent { link: Link::Connected, link_cause: None });
    let event = Event::new(at, Some("left".parse().unwrap()), detail);
    journal.record(Record::Event(event, Some(written)));
    is_written.await.unwrap();
}

async fn record(journal: &Journal, count: usize) {
    for _ in 0..count {
        record_at(journal, Now::read().wall).await;
    }
}

/// A run of the webhooks.
struct Run {
    runner: WebhookRunner,
    closing: CancellationToken,
    registry: Registry,
}

impl Run {
    fn start(settings: WebhookSettings, (journal, recovered): &(Journal, Recovered)) -> Self {
        let (closing, registry) = (CancellationToken::new(), Registry::new());
        let runner = WebhookRunner::new(WebhookContext {
            gateway: "cell-7".parse().unwrap(),
            journal: journal.clone(),
            registry: registry.clone(),
            closing: closing.clone(),
            runtime: Handle::current(),
        });
        // No webhook has to end first, so nothing is awaited.
        let changes = runner.prepare(&[settings]).unwrap();
        runner.apply(changes, &recovered.memory).now_or_never().unwrap().unwrap();
        Self { runner, closing, registry }
    }

    async fn reload(&self, settings: &[WebhookSettings]) {
        self.runner.apply(self.runner.prepare(settings).unwrap(), &[]).await.unwrap();
    }

    fn webhook(&self) -> Arc<Webhook> {
        self.runner.webhooks().all()[0].clone()
    }

    async fn until(&self, wanted: impl Fn(&Webhook) -> bool) {
        while !wanted(&self.webhook()) {
            tokio::task::yield_now().await;
        }
    }

    fn figures(&self) -> String {
        prometheus::TextEncoder::new().encode_to_string(&self.registry.gather()).unwrap()
    }

    async fn end(self) {
        self.closing.cancel();
        self.runner.ended().await;
    }
}

#[tokio::test]
async fn events_are_delivered_in_order_and_signed() {
    let mut receiver = TestReceiver::start(&[]).await;
    let opened = in_memory();
    record(&opened.0, 2).await;
    let run = Run::start(receiver.settings(), &opened);
    record(&opened.0, 3).await;
    let mut ids = Vec::new();
    for seq in 3..=5 {
        let got = receiver.next().await;
        assert_eq!(got.seq(), seq);
        assert_eq!(got.head, "POST /hooks?key=s3cret HTTP/1.1");
        assert_eq!(got.headers["host"], receiver.settings().receiver.authority());
        got.assert_signed();
        ids.push(got.id().to_owned());
    }
    let query = EventQuery { order: Order::Oldest, ..EventQuery::default() };
    assert_eq!(opened.0.events(query).await.unwrap().bodies.len(), 5);
    assert!(ids[0].starts_with("cell-7-3-") && ids[0] != ids[1], "{ids:?}");
    run.until(|webhook| webhook.waiting() == 0).await;
    assert!(run.webhook().progress().last_success_at.is_some());
    let figures = run.figures();
    assert!(figures.contains("wsg_webhook_deliveries_total{webhook=\"mes\"} 3"), "{figures}");
    assert!(figures.contains("wsg_webhook_waiting_events{webhook=\"mes\"} 0"), "{figures}");
    run.end().await;
}

#[tokio::test]
async fn failed_delivery_is_repeated_before_later_events() {
    let redirect = "302 Found\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n";
    let mut receiver = TestReceiver::start(&["503 Service Unavailable\r\n", redirect]).await;
    let opened = in_memory();
    let run = Run::start(receiver.settings(), &opened);
    record(&opened.0, 2).await;
    let (first, second, third) = (receiver.next().await, receiver.next().await, receiver.next().await);
    assert_eq!((first.seq(), second.seq(), third.seq()), (1, 1, 1));
    assert_eq!((first.id(), first.id()), (second.id(), third.id()));
    assert_eq!(receiver.next().await.seq(), 2);
    run.until(|webhook| webhook.waiting() == 0).await;
    let progress = run.webhook().progress();
    assert_eq!((progress.failed_attempts, progress.retry_at, progress.failing_since), (0, None, None));
    let error = progress.last_error.unwrap();
    assert!(error.contains("302") && error.contains("redirects") && !error.contains("s3cret"), "{error}");
    let figures = run.figures();
    assert!(figures.contains("wsg_webhook_failures_total{webhook=\"mes\"} 2"), "{figures}");
    run.end().await;
}

#[tokio::test]
async fn receiver_chooses_the_pause_and_a_test_ends_it() {
    let mut receiver = TestReceiver::start(&["429 Too Many Requests\r\nRetry-After: 600\r\n"]).await;
    let opened = in_memory();
    let run = Run::start(receiver.settings(), &opened);
    record(&opened.0, 1).await;
    assert_eq!(receiver.next().await.seq(), 1);
    run.until(|webhook| webhook.progress().retry_at.is_some()).await;
    let WebhookProgress { retry_at, last_error_at, failed_attempts, .. } = run.webhook().progress();
    assert_eq!(retry_at.unwrap().duration_since(last_error_at.unwrap()), SignedDuration::from_mins(10));
    assert_eq!((failed_attempts, run.webhook().waiting()), (1, 1));
    let tested = run.webhook().test().await.unwrap();
    assert_eq!(tested.result.unwrap(), StatusCode::NO_CONTENT);
    let test = receiver.next().await;
    test.assert_signed();
    assert_eq!((&test.body["kind"], &test.body["gateway"]), (&"test".into(), &"cell-7".into()));
    assert_eq!(receiver.next().await.seq(), 1);
    run.end().await;
}

#[tokio::test]
async fn only_chosen_kinds_are_delivered() {
    let mut receiver = TestReceiver::start(&[]).await;
    let opened = in_memory();
    let settings = WebhookSettings { kinds: Some(vec![EventKind::Gateway]), ..receiver.settings() };
    let run = Run::start(settings, &opened);
    record(&opened.0, 3).await;
    let (written, is_written) = oneshot::channel();
    let started = crate::model::GatewayEvent::Started { version: "1", gateway: "cell-7".to_owned() };
    let event = Event::new(Now::read().wall, None, Detail::Gateway(started));
    opened.0.record(Record::Event(event, Some(written)));
    is_written.await.unwrap();
    assert_eq!(receiver.next().await.seq(), 4);
    run.until(|webhook| webhook.waiting() == 0).await;
    run.end().await;
}

#[tokio::test]
async fn position_is_kept_over_restarts() {
    let (mut receiver, file) = (TestReceiver::start(&[]).await, JournalFile::new());
    // The gateway restarts even before the first delivery.
    for first in [1, 3, 6] {
        let opened = file.open(Retention::default());
        let run = Run::start(receiver.settings(), &opened);
        if first == 1 {
            run.end().await;
            record(&opened.0, 1).await;
        } else {
            record(&opened.0, 1).await;
            // The second of these events is the orderly end of the previous run.
            for seq in (first - 2).max(1)..=first {
                assert_eq!(receiver.next().await.seq(), seq);
            }
            run.until(|webhook| webhook.waiting() == 0).await;
            run.end().await;
            assert!(receiver.got.try_recv().is_err());
            record(&opened.0, 1).await;
        }
        opened.0.close().await.unwrap();
    }
}

#[tokio::test]
async fn changed_webhook_continues_and_an_unchanged_one_is_left_alone() {
    let [mut first, mut second] = [TestReceiver::start(&[]).await, TestReceiver::start(&[]).await];
    let opened = in_memory();
    let run = Run::start(first.settings(), &opened);
    record(&opened.0, 2).await;
    assert_eq!((first.next().await.seq(), first.next().await.seq()), (1, 2));
    run.until(|webhook| webhook.waiting() == 0).await;
    let before = run.webhook();
    run.reload(&[first.settings()]).await;
    assert!(Arc::ptr_eq(&before, &run.webhook()), "the same settings");
    run.reload(&[second.settings()]).await;
    record(&opened.0, 2).await;
    assert_eq!((second.next().await.seq(), second.next().await.seq()), (3, 4));
    run.until(|webhook| webhook.waiting() == 0).await;
    assert!(first.got.try_recv().is_err());
    assert!(run.figures().contains("wsg_webhook_deliveries_total{webhook=\"mes\"} 2"), "{}", run.figures());
    run.reload(&[]).await;
    assert!(run.runner.webhooks().all().is_empty() && run.figures().is_empty(), "{}", run.figures());
    run.end().await;
}

#[tokio::test]
async fn changed_webhook_repeats_what_the_old_receiver_refused() {
    let mut first = TestReceiver::start(&["503 Service Unavailable\r\nRetry-After: 600\r\n"]).await;
    let mut second = TestReceiver::start(&[]).await;
    let opened = in_memory();
    let run = Run::start(first.settings(), &opened);
    record(&opened.0, 1).await;
    let refused = first.next().await;
    run.until(|webhook| webhook.progress().retry_at.is_some()).await;
    run.reload(&[second.settings()]).await;
    assert_eq!(second.next().await.id(), refused.id());
    run.end().await;
}

#[tokio::test]
async fn removed_events_are_a_gap() {
    let (mut receiver, file) = (TestReceiver::start(&[]).await, JournalFile::new());
    let opened = file.open(Retention::default());
    Run::start(receiver.settings(), &opened).end().await;
    let long_ago = Now::read().wall - SignedDuration::from_hours(48);
    for _ in 0..4 {
        record_at(&opened.0, long_ago).await;
    }
    opened.0.close().await.unwrap();

    let opened = file.open(Retention { max_age: Some(Duration::from_hours(1)), max_bytes: None });
    // Four events, the end of the run, and the removal.
    let mut events = opened.0.follow(Some(5), crate::journal::Filter::default());
    events.next().await.unwrap().unwrap();
    while opened.0.events(EventQuery::default()).await.unwrap().bodies.len() > 2 {
        tokio::task::yield_now().await;
    }
    let run = Run::start(receiver.settings(), &opened);
    let gap = receiver.next().await;
    gap.assert_signed();
    let notice = serde_json::json!({"kind": "gap", "gateway": "cell-7", "seq": 0, "missed": 4});
    assert_eq!(gap.body, notice);
    assert_eq!((receiver.next().await.seq(), receiver.next().await.seq()), (5, 6));
    run.end().await;
}

#[tokio::test]
async fn certificate_is_checked() {
    let certified = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let (certificate, key) = (certified.cert.der().clone(), certified.signing_key.serialize_der());
    let provider = Arc::new(tokio_rustls::rustls::crypto::ring::default_provider());
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_no_client_auth()
        .with_single_cert(vec![certificate], PrivateKeyDer::Pkcs8(key.into()))
        .unwrap();
    let mut receiver = TestReceiver::serve(&[], Some(Arc::new(config).into())).await;
    let trusting = WebhookSettings {
        authorities: Authorities::from_pem(certified.cert.pem().as_bytes()).unwrap(),
        ..receiver.settings()
    };
    let opened = in_memory();
    let run = Run::start(receiver.settings(), &opened);
    let failure = run.webhook().test().await.unwrap().result.unwrap_err();
    assert!(matches!(failure, DeliveryFailure::Tls { .. }) && failure.to_string().contains("ca_file"), "{failure}");
    run.end().await;
    let run = Run::start(trusting, &opened);
    assert_eq!(run.webhook().test().await.unwrap().result.unwrap(), StatusCode::NO_CONTENT);
    receiver.next().await.assert_signed();
    run.end().await;
}

#[tokio::test]
async fn failed_test_names_the_cause() {
    let receiver = TestReceiver::start(&["500 Internal Server Error\r\n", "nonsense"]).await;
    let opened = in_memory();
    let run = Run::start(receiver.settings(), &opened);
    let refused = run.webhook().test().await.unwrap().result.unwrap_err();
    assert_eq!(refused.status(), Some(StatusCode::INTERNAL_SERVER_ERROR));
    let invalid = run.webhook().test().await.unwrap().result.unwrap_err();
    assert!(matches!(invalid, DeliveryFailure::Response { .. }), "{invalid}");
    run.end().await;

    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    drop(listener);
    let run = Run::start(WebhookSettings { receiver: url.parse().unwrap(), ..receiver.settings() }, &opened);
    let unreachable = run.webhook().test().await.unwrap().result.unwrap_err();
    assert!(unreachable.to_string().starts_with(&format!("cannot connect to {url}: ")), "{unreachable}");
    run.end().await;
}

#[tokio::test]
async fn shutdown_does_not_wait_for_a_failing_receiver() {
    let mut receiver = TestReceiver::start(&["503 Service Unavailable\r\nRetry-After: 3600\r\n"]).await;
    let opened = in_memory();
    let run = Run::start(receiver.settings(), &opened);
    record(&opened.0, 1).await;
    receiver.next().await;
    run.until(|webhook| webhook.progress().retry_at.is_some()).await;
    run.end().await;
}
