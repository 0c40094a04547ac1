//! The server on a socket, tested with raw bytes.

use std::time::Instant;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::task::JoinHandle;

use super::*;
use crate::connections::admission::{Bounds, Class};
use crate::gripper::fake::{self, FakeScript, Fate, Seen};
use crate::interfaces::http::WebSettings;
use crate::model::GripperStatus;

struct Server {
    address: SocketAddr,
    shutdown: CancellationToken,
    task: JoinHandle<()>,
    seen: UnboundedReceiver<Seen>,
}

async fn start(limits: ServerLimits, script: FakeScript) -> Server {
    start_with(limits, HttpSettings::default(), script).await
}

async fn start_with(limits: ServerLimits, settings: HttpSettings, script: FakeScript) -> Server {
    let (handle, seen) = fake::gripper("left", script);
    let context = HttpContext::of([handle]);
    context.settings.replace(settings);
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let shutdown = CancellationToken::new();
    let (_, listeners) = watch::channel(Arc::new(listener));
    let task = tokio::spawn(serve(listeners, Arc::new(context), limits, shutdown.clone()));
    Server { address, shutdown, task, seen }
}

impl Server {
    async fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).await.unwrap()
    }

    /// Sends a request and returns all bytes until the server closes the connection.
    async fn exchange(&self, request: &[u8]) -> String {
        let mut stream = self.connect().await;
        stream.write_all(request).await.unwrap();
        rest(&mut stream).await
    }
}

async fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).await.unwrap();
    String::from_utf8(bytes).unwrap()
}

/// Reads one response of a connection that stays open.
async fn answer(stream: &mut TcpStream) -> String {
    let mut answer = String::new();
    let mut buffer = [0; 4096];
    loop {
        let bytes = stream.read(&mut buffer).await.unwrap();
        assert!(bytes > 0, "closed after {answer:?}");
        answer.push_str(std::str::from_utf8(&buffer[..bytes]).unwrap());
        if let Some((head, body)) = answer.split_once("\r\n\r\n") {
            let length = head.lines().find_map(|line| line.strip_prefix("content-length: ")).unwrap();
            if body.len() == length.parse::<usize>().unwrap() {
                return answer;
            }
        }
    }
}

const HEALTH: &[u8] = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";

#[tokio::test]
async fn connection_is_reused() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    let mut stream = server.connect().await;
    for _ in 0..3 {
        stream.write_all(HEALTH).await.unwrap();
        assert!(answer(&mut stream).await.starts_with("HTTP/1.1 200 OK\r\n"));
    }
}

#[tokio::test]
async fn http_1_0_without_a_host_is_served() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    let answer = server.exchange(b"GET /healthz HTTP/1.0\r\n\r\n").await;
    assert!(answer.starts_with("HTTP/1.0 200 OK\r\n") && answer.contains(r#""status":"ok""#), "{answer}");
    assert!(answer.contains("content-length: ") && !answer.contains("transfer-encoding"));
}

#[tokio::test]
async fn keep_alive_states_the_idle_time() {
    let web = WebSettings { idle_timeout: Duration::from_secs(25), ..WebSettings::default() };
    let settings = HttpSettings { web, ..HttpSettings::default() };
    let server = start_with(ServerLimits::default(), settings, FakeScript::default()).await;
    let mut stream = server.connect().await;
    stream.write_all(HEALTH).await.unwrap();
    let answer = answer(&mut stream).await;
    assert!(answer.contains("\r\nkeep-alive: timeout=25\r\n") && answer.contains("\r\ndate: "), "{answer}");
}

#[tokio::test]
async fn connection_that_ends_is_not_kept_alive() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    for request in [
        "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n",
        "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: TE, Close\r\n\r\n",
        "GET /healthz HTTP/1.0\r\n\r\n",
        "POST /nowhere HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\nContent-Length: 100000\r\n\r\n",
    ] {
        let answer = server.exchange(request.as_bytes()).await;
        assert!(answer.starts_with("HTTP/1.") && !answer.contains("\r\nkeep-alive: "), "{answer}");
    }
    let mut stream = server.connect().await;
    stream.write_all(b"GET /healthz HTTP/1.0\r\nConnection: keep-alive\r\n\r\n").await.unwrap();
    let answer = answer(&mut stream).await;
    assert!(answer.contains("\r\nkeep-alive: timeout=10\r\n"), "{answer}");
}

#[tokio::test]
async fn status_response_is_smaller_than_256_bytes() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    let mut stream = server.connect().await;
    stream.write_all(b"GET /api/v1/grippers/left/status HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    let answer = answer(&mut stream).await;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    let (_, fields) = head.split_once("\r\n").unwrap();
    let header: Vec<_> = fields.lines().filter_map(|line| line.split(':').next()).collect();
    assert_eq!(header, ["content-type", "content-length"]);
    serde_json::from_str::<serde_json::Value>(body).unwrap();
    let longest = GripperStatus {
        busy: false,
        done: false,
        ok: false,
        nok: false,
        holding: false,
        fault: false,
        fault_code: 999,
        last_command: u32::MAX,
        last_outcome_code: u8::MAX,
        lease_epoch: u64::from(u32::MAX),
    };
    let longest = head.len() + 4 + serde_json::to_string(&longest).unwrap().len();
    assert!(longest < 256, "{longest} bytes");
}

#[tokio::test]
async fn incomplete_header_times_out() {
    let idle_time = Duration::from_millis(50);
    let web = WebSettings { idle_timeout: idle_time, ..WebSettings::default() };
    let settings = HttpSettings { web, ..HttpSettings::default() };
    let server = start_with(ServerLimits::default(), settings, FakeScript::default()).await;
    let start = Instant::now();
    assert_eq!(server.exchange(b"GET /healthz HTTP/1.1\r\nHost: loc").await, "");
    assert!(start.elapsed() >= idle_time);
}

#[tokio::test]
async fn oversized_body_is_read_and_answered() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    let body = vec![b' '; 1024 * 1024];
    for path in ["/api/v1/grippers/left/home", "/nowhere"] {
        let head = format!("POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {}\r\n\r\n", body.len());
        let answer = server.exchange(&[head.as_bytes(), &body].concat()).await;
        assert!(answer.starts_with("HTTP/1.1 413 Payload Too Large\r\n"), "{answer}");
        assert!(answer.contains(r#""code":"too_large""#) && answer.contains(r#""max":65536"#), "{answer}");
    }
}

#[tokio::test]
async fn oversized_body_is_refused_before_it_is_sent() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    for path in ["/api/v1/grippers/left/home", "/nowhere"] {
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\nContent-Length: 100000\r\n\r\n"
        );
        let answer = server.exchange(head.as_bytes()).await;
        assert!(answer.starts_with("HTTP/1.1 413 ") && answer.contains(r#""max":65536"#), "{answer}");
    }
}

#[tokio::test]
async fn oversized_body_of_unknown_length_after_100_continue_is_answered() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    let mut stream = server.connect().await;
    let head = "POST /api/v1/grippers/left/home HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\n\
                Transfer-Encoding: chunked\r\n\r\n";
    stream.write_all(head.as_bytes()).await.unwrap();
    let mut go_on = [0; 25];
    stream.read_exact(&mut go_on).await.unwrap();
    assert_eq!(&go_on, b"HTTP/1.1 100 Continue\r\n\r\n");
    let chunk = [&b"186a0\r\n"[..], &vec![b' '; 100_000], b"\r\n0\r\n\r\n"].concat();
    stream.write_all(&chunk).await.unwrap();
    assert!(rest(&mut stream).await.starts_with("HTTP/1.1 413 "));
}

#[tokio::test]
async fn compressed_body_is_refused_except_for_stops() {
    let mut server = start(ServerLimits::default(), FakeScript::default()).await;
    let answer = async |path: &str, encoding: &str| {
        let head = format!(
            "POST /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Encoding: {encoding}\r\n\
             Content-Length: 2\r\n\r\n{{}}"
        );
        server.exchange(head.as_bytes()).await
    };
    let refused = answer("grippers/left/home", "gzip").await;
    assert!(refused.starts_with("HTTP/1.1 415 ") && refused.contains("unsupported_encoding"), "{refused}");
    assert!(refused.contains("\r\naccept-encoding: identity\r\n"), "{refused}");
    for (path, encoding) in [("grippers/left/home", "identity"), ("grippers/left/stop", "gzip"), ("fast-stop", "gzip")]
    {
        let answer = answer(path, encoding).await;
        assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{path}: {answer}");
    }
    let mut seen = 0;
    while server.seen.try_recv().is_ok() {
        seen += 1;
    }
    assert_eq!(seen, 3, "the refused request reaches no gripper");
}

/// Limits with one connection for each class.
fn narrow() -> ServerLimits {
    ServerLimits::within(Bounds::narrow())
}

#[tokio::test]
async fn longest_idle_connection_gives_way() {
    let server = start(narrow(), FakeScript::default()).await;
    let mut first = server.connect().await;
    first.write_all(HEALTH).await.unwrap();
    answer(&mut first).await;
    let mut second = server.connect().await;
    second.write_all(HEALTH).await.unwrap();
    answer(&mut second).await;
    assert_eq!(rest(&mut first).await, "");
}

#[tokio::test]
async fn half_sent_body_gives_way() {
    let server = start(narrow(), FakeScript::default()).await;
    let mut first = server.connect().await;
    // The 100 Continue shows that the request has arrived and waits for its body.
    let head = "POST /api/v1/grippers/left/home HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\n\
                Content-Length: 2\r\n\r\n";
    first.write_all(head.as_bytes()).await.unwrap();
    let mut go_on = [0; 25];
    first.read_exact(&mut go_on).await.unwrap();
    let health = server.exchange(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").await;
    assert!(health.starts_with("HTTP/1.1 200 OK\r\n"), "{health}");
    assert_eq!(rest(&mut first).await, "");
}

#[tokio::test]
async fn long_poll_beyond_the_bound_is_answered_at_once() {
    let limits = ServerLimits::within(Bounds::narrow().with(Class::Incoming, 2).with(Class::Answering, 2));
    let server = start(limits, FakeScript { fate: Fate::Runs, ..FakeScript::default() }).await;
    let mut first = server.connect().await;
    let home = "POST /api/v1/grippers/left/home?wait_ms=60000 HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n\r\n";
    first.write_all(home.as_bytes()).await.unwrap();
    let waiting = async {
        let mut second = server.connect().await;
        loop {
            // The kernel decides which of the two waits.
            second.write_all(home.as_bytes()).await.unwrap();
            let answer = answer(&mut second).await;
            if answer.starts_with("HTTP/1.1 202 ") {
                return answer;
            }
        }
    };
    let answer = tokio::select! {
        answer = waiting => answer,
        answer = answer(&mut first) => answer,
    };
    assert!(answer.contains("\r\nlocation: /api/v1/grippers/left/commands/"), "{answer}");
}

#[tokio::test]
async fn evicted_connection_has_a_moment_for_a_fast_stop() {
    let limits = ServerLimits::within(Bounds::of(64).with(Class::Incoming, 1));
    let server = start(limits, FakeScript::default()).await;
    let mut answered = 0;
    // On a busy machine, the moment can pass before the request is sent.
    for _ in 0..20 {
        let mut evicted = server.connect().await;
        // An answer shows that the server has admitted the second connection, which evicts the first.
        let mut second = server.connect().await;
        second.write_all(HEALTH).await.unwrap();
        answer(&mut second).await;
        let head =
            "POST /api/v1/fast-stop HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 0\r\n\r\n";
        let mut answer = Vec::new();
        let _ = evicted.write_all(head.as_bytes()).await;
        let _ = evicted.read_to_end(&mut answer).await;
        answered += u32::from(answer.starts_with(b"HTTP/1.1 200 OK\r\n"));
    }
    assert!(answered >= 10, "{answered} of 20 FAST STOPs were answered");
}

#[tokio::test]
async fn shutdown_ends_idle_connections_and_finishes_requests() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    let mut idle = server.connect().await;
    idle.write_all(HEALTH).await.unwrap();
    answer(&mut idle).await;
    let mut busy = server.connect().await;
    let head = "POST /api/v1/grippers/left/home HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\n\
                Content-Length: 2\r\n\r\n";
    busy.write_all(head.as_bytes()).await.unwrap();
    let mut go_on = [0; 25];
    busy.read_exact(&mut go_on).await.unwrap();
    server.shutdown.cancel();
    assert_eq!(rest(&mut idle).await, "");
    busy.write_all(b"{}").await.unwrap();
    assert!(rest(&mut busy).await.starts_with("HTTP/1.1 200 OK\r\n"));
    server.task.await.unwrap();
}

#[tokio::test]
async fn shutdown_is_bounded() {
    let limits = ServerLimits { shutdown_time: Duration::from_millis(50), ..ServerLimits::default() };
    let server = start(limits, FakeScript { fate: Fate::Runs, ..FakeScript::default() }).await;
    let mut busy = server.connect().await;
    let head = "POST /api/v1/grippers/left/home?wait_ms=60000 HTTP/1.1\r\nHost: localhost\r\n\
                Expect: 100-continue\r\nContent-Length: 2\r\n\r\n";
    busy.write_all(head.as_bytes()).await.unwrap();
    let mut go_on = [0; 25];
    busy.read_exact(&mut go_on).await.unwrap();
    server.shutdown.cancel();
    server.task.await.unwrap();
}

#[tokio::test]
async fn fast_stop_survives_client_disconnect() {
    let mut server = start(ServerLimits::default(), FakeScript::default()).await;
    let mut client = server.connect().await;
    let head = b"POST /api/v1/fast-stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 20\r\n\r\n{\"rea";
    client.write_all(head).await.unwrap();
    drop(client);
    assert!(matches!(server.seen.recv().await, Some(Seen::FastStop(reason)) if reason.as_str().is_empty()));
}

#[tokio::test]
async fn stops_without_a_body_survive_client_disconnect() {
    let mut server = start(ServerLimits::default(), FakeScript::default()).await;
    for path in ["fast-stop", "grippers/left/fast-stop", "grippers/left/stop"] {
        let mut client = server.connect().await;
        // The server sees the request and the end of the connection at the same time.
        let head = format!("POST /api/v1/{path} HTTP/1.1\r\nHost: localhost\r\n\r\n");
        client.write_all(head.as_bytes()).await.unwrap();
        drop(client);
        let seen = server.seen.recv().await.unwrap();
        assert_eq!(matches!(seen, Seen::FastStop(_)), path.ends_with("fast-stop"), "{path}: {seen:?}");
    }
}

#[tokio::test]
async fn fast_stop_with_oversized_body_is_answered() {
    let server = start(ServerLimits::default(), FakeScript::default()).await;
    let body = vec![b' '; 1024 * 1024];
    let head =
        "POST /api/v1/fast-stop HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: 1048576\r\n\r\n";
    let answer = server.exchange(&[head.as_bytes(), &body].concat()).await;
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n") && answer.contains(r#""confirmed":["left"]"#), "{answer}");
}
