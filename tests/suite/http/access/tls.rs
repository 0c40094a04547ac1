//! HTTPS, from the first start on a network.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures_util::{SinkExt as _, StreamExt as _};
use http::{Request, Response};
use http_body_util::{BodyExt as _, Full};
use hyper::body::Incoming;
use hyper::client::conn::http1::handshake;
use hyper_util::rt::TokioIo;
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use serde_json::{Value, json};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinSet;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::client::Resumption;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_util::task::AbortOnDropHandle;
use wsg_gateway::connections::self_signed::SelfSigned;

use crate::harness::{Directory, Process, eventually, run};

/// A client's certificate and key.
type ClientCertificate = (CertificateDer<'static>, PrivateKeyDer<'static>);

/// A gateway as `init` configures it.
struct Initialised {
    // Ends before the directory is removed.
    _process: Process,
    directory: Directory,
    address: SocketAddr,
    token: String,
}

async fn initialised() -> Initialised {
    initialised_with(|_, config| config).await
}

/// A gateway as `init` configures it, whose configuration and directory are changed before it starts.
async fn initialised_with(change: impl FnOnce(&Directory, String) -> String) -> Initialised {
    let directory = Directory::new();
    let said = run(&["init", "--listen", "127.0.0.1:0", "--host", "localhost", directory.path()]).await;
    assert!(said.status.success(), "{said:?}");
    let token = said.stdout.lines().last().unwrap().to_owned();
    let config = directory.file("wsg-gateway.toml");
    let changed = change(&directory, std::fs::read_to_string(&config).unwrap());
    std::fs::write(&config, changed).unwrap();
    let process = Process::start(&["--config", &config, "--zenoh-listen", "tcp/127.0.0.1:0"]);
    let address = process.word_after(" at https://").await.trim_end_matches('/').parse().unwrap();
    Initialised { directory, address, token, _process: process }
}

/// Connects with TLS, trusting the certificate in the gateway's directory.
async fn secure_stream(gateway: &Initialised) -> std::io::Result<TlsStream<TcpStream>> {
    secure_stream_of(gateway, [127, 0, 0, 1], None).await
}

/// Connects from an address, as the holder of a certificate.
async fn secure_stream_of(
    gateway: &Initialised,
    from: [u8; 4],
    own: Option<&ClientCertificate>,
) -> std::io::Result<TlsStream<TcpStream>> {
    let read = |name| std::fs::read(gateway.directory.file(name));
    let pem = read("authority.pem").or_else(|_| read("certificate.pem")).unwrap();
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(&pem).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(default_provider()));
    let config = config.with_safe_default_protocol_versions().unwrap();
    let config = config.with_root_certificates(roots);
    let mut config = match own {
        Some((certificate, key)) => config.with_client_auth_cert(vec![certificate.clone()], key.clone_key()).unwrap(),
        None => config.with_no_client_auth(),
    };
    config.resumption = Resumption::disabled();
    let socket = TcpSocket::new_v4()?;
    socket.bind((from, 0).into())?;
    let stream = socket.connect(gateway.address).await?;
    TlsConnector::from(Arc::new(config)).connect(ServerName::try_from("localhost").unwrap(), stream).await
}

/// An HTTPS client of one connection.
struct HttpsClient {
    http: hyper::client::conn::http1::SendRequest<Full<Bytes>>,
    _connection: AbortOnDropHandle<hyper::Result<()>>,
}

impl HttpsClient {
    async fn connect(gateway: &Initialised) -> Result<Self, std::io::Error> {
        Ok(Self::over(secure_stream(gateway).await?).await)
    }

    async fn over(stream: TlsStream<TcpStream>) -> Self {
        let (http, connection) = handshake(TokioIo::new(stream)).await.unwrap();
        Self { http, _connection: AbortOnDropHandle::new(tokio::spawn(connection)) }
    }

    async fn send(&mut self, method: &str, path: &str, token: Option<&str>, body: &Value) -> Response<Incoming> {
        let request = Request::builder().method(method).uri(path).header("Host", "localhost");
        let request = match token {
            Some(token) => request.header("Authorization", format!("Bearer {token}")),
            None => request,
        };
        let body = if body.is_null() { String::new() } else { body.to_string() };
        self.http.send_request(request.body(Full::from(body)).unwrap()).await.unwrap()
    }

    async fn status(&mut self, method: &str, path: &str, token: Option<&str>) -> u16 {
        let response = self.send(method, path, token, &Value::Null).await;
        let status = response.status().as_u16();
        response.into_body().collect().await.unwrap();
        status
    }
}

#[tokio::test]
async fn initialised_gateway_serves_https_with_its_first_token() {
    let gateway = initialised().await;
    let mut client = HttpsClient::connect(&gateway).await.unwrap();
    let page = client.send("GET", "/", None, &Value::Null).await;
    assert_eq!((page.status().as_u16(), page.headers().contains_key("strict-transport-security")), (200, true));
    page.into_body().collect().await.unwrap();
    let (home, stop, token) = ("/api/v1/grippers/left/home", "/api/v1/fast-stop", Some(gateway.token.as_str()));
    assert_eq!(client.status("POST", home, None).await, 401);
    assert_eq!(client.status("POST", home, token).await, 200);
    let session = client.send("POST", "/api/v1/session", None, &json!({"token": gateway.token})).await;
    assert!(session.headers()["set-cookie"].to_str().unwrap().contains("; Secure"));
    // A connection that begins with a FAST STOP is served elsewhere.
    let mut first = HttpsClient::connect(&gateway).await.unwrap();
    assert_eq!(first.status("POST", stop, None).await, 401);
    let mut first = HttpsClient::connect(&gateway).await.unwrap();
    assert_eq!(first.status("POST", stop, token).await, 200);
}

#[tokio::test]
async fn reads_without_tls_are_redirected_and_changes_refused() {
    let gateway = initialised().await;
    let client = reqwest::Client::builder().redirect(reqwest::redirect::Policy::none()).build().unwrap();
    let plain = format!("http://{}", gateway.address);
    let page = client.get(format!("{plain}/docs?x=1")).send().await.unwrap();
    assert_eq!(page.status(), 307);
    assert_eq!(page.headers()["location"].to_str().unwrap(), format!("https://{}/docs?x=1", gateway.address));
    let change = client.post(format!("{plain}/api/v1/grippers/left/home")).send().await.unwrap();
    assert_eq!(change.status(), 400);
}

#[tokio::test]
async fn websocket_works_over_tls() {
    let gateway = initialised().await;
    let mut request = "wss://localhost/api/v1/ws".into_client_request().unwrap();
    let headers = request.headers_mut();
    headers.insert("Sec-WebSocket-Protocol", "wsg.v1".parse().unwrap());
    headers.insert("Authorization", format!("Bearer {}", gateway.token).parse().unwrap());
    let (mut socket, _) = client_async(request, secure_stream(&gateway).await.unwrap()).await.unwrap();
    let call = json!({"jsonrpc": "2.0", "id": 1, "method": "fast-stop", "params": {}});
    socket.send(Message::text(call.to_string())).await.unwrap();
    let answer = loop {
        // Pings arrive all the time.
        match socket.next().await.unwrap().unwrap() {
            Message::Ping(_) => {}
            answer => break answer,
        }
    };
    assert!(answer.to_text().unwrap().contains("fast_stop_confirmed"), "{answer}");
}

#[tokio::test]
async fn replaced_certificate_serves_new_connections() {
    let gateway = initialised().await;
    let mut old = HttpsClient::connect(&gateway).await.unwrap();
    assert_eq!(old.status("GET", "/healthz", None).await, 200);
    for name in ["certificate.pem", "key.pem"] {
        std::fs::remove_file(gateway.directory.file(name)).unwrap();
    }
    let renewed = run(&["certificate", "--host", "localhost", gateway.directory.path()]).await;
    assert!(renewed.status.success(), "{renewed:?}");
    assert_eq!(old.status("GET", "/healthz", None).await, 200, "the open connection continues");
    let mut new = HttpsClient::connect(&gateway).await.unwrap();
    assert_eq!(new.status("GET", "/healthz", None).await, 200);
}

/// An authority that signs certificates of clients.
fn authority(name: &str) -> (Issuer<'static, KeyPair>, String) {
    let mut params = CertificateParams::new([]).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    params.distinguished_name.push(DnType::CommonName, name);
    let key = KeyPair::generate().unwrap();
    let pem = params.self_signed(&key).unwrap().pem();
    (Issuer::new(params, key), pem)
}

fn certificate_of(name: &str, authority: &Issuer<'static, KeyPair>) -> ClientCertificate {
    let mut params = CertificateParams::new([]).unwrap();
    params.distinguished_name.push(DnType::CommonName, name);
    let key = KeyPair::generate().unwrap();
    let certificate = params.signed_by(&key, authority).unwrap();
    (certificate.der().clone(), PrivateKeyDer::try_from(key.serialize_der()).unwrap())
}

#[tokio::test]
async fn client_is_known_by_its_certificate() {
    let (plant, ca) = authority("plant");
    let gateway = initialised_with(|directory, config| {
        directory.write("clients.pem", &ca);
        let config = config.replace("key = \"key.pem\"", "key = \"key.pem\"\nclient_ca = \"clients.pem\"");
        format!("{config}\n[[clients]]\nname = \"mes\"\ncertificate = \"mes.example\"\nrole = \"observer\"\n")
    })
    .await;
    let ask = async |own: &ClientCertificate| -> std::io::Result<(u16, Value)> {
        let mut client = HttpsClient::over(secure_stream_of(&gateway, [127, 0, 0, 1], Some(own)).await?).await;
        let answer = client.http.ready().await;
        answer.map_err(std::io::Error::other)?;
        let answer = client.send("GET", "/api/v1/me", None, &Value::Null).await;
        let status = answer.status().as_u16();
        Ok((status, serde_json::from_slice(&answer.into_body().collect().await.unwrap().to_bytes()).unwrap()))
    };
    let (status, me) = ask(&certificate_of("mes.example", &plant)).await.unwrap();
    assert_eq!((status, &me["name"], &me["proof"]), (200, &"mes".into(), &"certificate".into()), "{me}");
    let (status, _) = ask(&certificate_of("other.example", &plant)).await.unwrap();
    assert_eq!(status, 401);
    // A certificate of another authority ends the connection. With TLS 1.3, the client notices after its handshake.
    let foreign = certificate_of("mes.example", &authority("elsewhere").0);
    let mut refused = secure_stream_of(&gateway, [127, 0, 0, 1], Some(&foreign)).await.unwrap();
    let read = tokio::io::AsyncReadExt::read(&mut refused, &mut [0; 8]).await;
    assert!(read.is_err(), "{read:?}");
    let mut nobody = HttpsClient::connect(&gateway).await.unwrap();
    assert_eq!(nobody.status("GET", "/api/v1/me", None).await, 401);
    assert_eq!(nobody.status("GET", "/api/v1/me", Some(&gateway.token)).await, 200);
}

/// Time that a FAST STOP may take during a flood, on a machine that also runs the flood and other tests.
const STOPPED_WITHIN: Duration = Duration::from_secs(1);

#[tokio::test(flavor = "multi_thread")]
async fn flood_of_handshakes_delays_no_fast_stop() {
    let gateway = Arc::new(initialised().await);
    let handshakes = Arc::new(AtomicU32::new(0));
    let flood = |_| {
        let (gateway, handshakes) = (gateway.clone(), handshakes.clone());
        AbortOnDropHandle::new(tokio::spawn(async move {
            loop {
                if secure_stream_of(&gateway, [127, 0, 0, 2], None).await.is_ok() {
                    handshakes.fetch_add(1, Ordering::Relaxed);
                }
            }
        }))
    };
    let flooding: Vec<_> = (0..64).map(flood).collect();
    let start = Instant::now();
    let (mut fresh, mut open) = (Vec::new(), Vec::new());
    let mut client = HttpsClient::connect(&gateway).await.unwrap();
    for _ in 0..40 {
        let begun = Instant::now();
        let mut new = HttpsClient::connect(&gateway).await.unwrap();
        assert_eq!(new.status("POST", "/api/v1/fast-stop", Some(&gateway.token)).await, 200);
        fresh.push(begun.elapsed());
        let begun = Instant::now();
        assert_eq!(client.status("POST", "/api/v1/fast-stop", Some(&gateway.token)).await, 200);
        open.push(begun.elapsed());
    }
    let rate = f64::from(handshakes.load(Ordering::Relaxed)) / start.elapsed().as_secs_f64();
    drop(flooding);
    fresh.sort();
    open.sort();
    println!(
        "{rate:.0} handshakes/s; FAST STOP with a new connection: p50 {:?}, p90 {:?}, max {:?}; on an open one: p50 {:?}, \
         p90 {:?}, max {:?}",
        fresh[20], fresh[36], fresh[39], open[20], open[36], open[39]
    );
    assert!(fresh[36] < STOPPED_WITHIN && open[36] < STOPPED_WITHIN, "{fresh:?} {open:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn certificate_swapped_under_load_drops_nothing() {
    let (plant, ca) = authority("plant");
    let plant = Arc::new(plant);
    let swap = |directory: &Directory| {
        let mut params = CertificateParams::new(["localhost".to_owned()]).unwrap();
        params.distinguished_name.push(DnType::CommonName, "gateway");
        let key = KeyPair::generate().unwrap();
        let certificate = params.signed_by(&key, &*plant).unwrap();
        directory.write("certificate.pem", &certificate.pem());
        directory.write("key.pem", &key.serialize_pem());
    };
    let gateway = initialised_with(|directory, config| {
        directory.write("authority.pem", &ca);
        swap(directory);
        config
    })
    .await;
    let gateway = Arc::new(gateway);
    let served = Arc::new(AtomicU32::new(0));
    let mut loads = JoinSet::new();
    for _ in 0..8 {
        let (gateway, served) = (gateway.clone(), served.clone());
        loads.spawn(async move {
            loop {
                let mut client = HttpsClient::connect(&gateway).await.unwrap();
                for _ in 0..5 {
                    assert_eq!(client.status("GET", "/healthz", None).await, 200);
                }
                served.fetch_add(1, Ordering::Relaxed);
            }
        });
    }
    let mut open = HttpsClient::connect(&gateway).await.unwrap();
    for _ in 0..20 {
        swap(&gateway.directory);
        let before = served.load(Ordering::Relaxed);
        eventually("connections after the swap", async || (served.load(Ordering::Relaxed) > before + 16).then_some(()))
            .await;
        assert_eq!(open.status("GET", "/healthz", None).await, 200, "the open connection continues");
    }
    println!("{} connections during 20 swaps", served.load(Ordering::Relaxed));
    assert!(loads.try_join_next().is_none(), "no request failed");
    loads.shutdown().await;
}

/// Replaces the certificate that `init` has made by one that ends in this number of days.
fn let_certificate_end(directory: &Directory, days_left: i64) {
    let begin = jiff::Timestamp::now() + jiff::SignedDuration::from_hours((days_left - 823) * 24);
    let made = SelfSigned::create("gateway", &["localhost".to_owned()], begin).unwrap();
    directory.write("certificate.pem", &made.certificate);
    directory.write("key.pem", &made.key);
    // Clients trust the old certificate.
    directory.write("authority.pem", &made.certificate);
}

#[tokio::test]
async fn self_signed_certificate_is_renewed_for_clients_that_know_its_key() {
    let gateway = initialised_with(|directory, config| {
        let_certificate_end(directory, 1);
        config
    })
    .await;
    let old = std::fs::read_to_string(gateway.directory.file("authority.pem")).unwrap();
    eventually("a new certificate", async || {
        let new = std::fs::read_to_string(gateway.directory.file("certificate.pem")).unwrap();
        (new != old).then_some(())
    })
    .await;
    let stream = secure_stream(&gateway).await.unwrap();
    let served = stream.get_ref().1.peer_certificates().unwrap()[0].clone();
    assert_ne!(served, CertificateDer::from_pem_slice(old.as_bytes()).unwrap());
}

#[tokio::test]
async fn pinned_certificate_is_kept_and_its_end_is_an_alarm() {
    let gateway = initialised_with(|directory, config| {
        let_certificate_end(directory, 5);
        config.replace("[tls]\n", "[tls]\npinned = true\n")
    })
    .await;
    let mut client = HttpsClient::connect(&gateway).await.unwrap();
    let alarm = loop {
        let response = client.send("GET", "/api/v1/alarms", Some(&gateway.token), &Value::Null).await;
        let body = response.into_body().collect().await.unwrap().to_bytes();
        let listed: Value = serde_json::from_slice(&body).unwrap();
        let found = listed["alarms"].as_array().unwrap().iter().find(|one| one["alarm"] == "certificate_expiring");
        if let Some(alarm) = found {
            break alarm.clone();
        }
        tokio::task::yield_now().await;
    };
    assert!(alarm["name"].as_str().unwrap().ends_with("certificate.pem"), "{alarm}");
    assert!(alarm["cause"].as_str().unwrap().starts_with("expires on "), "{alarm}");
    let [old, new] =
        ["authority.pem", "certificate.pem"].map(|name| std::fs::read(gateway.directory.file(name)).unwrap());
    assert_eq!(old, new);
}
