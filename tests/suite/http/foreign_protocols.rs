//! Clients that speak another protocol than the port. A web page can make a browser connect to any port of its machine:
//! with HTTP whose body it chooses, with the handshake of a WebSocket, over TLS, and with datagrams (WebRTC).

use std::net::SocketAddr;

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpStream, UdpSocket};

use crate::harness::wsg::{Driver, PENDING, floats, request};
use crate::harness::{DEADLINE, Gateway, Proxy, Simulator, ZenohClient, eventually};

/// Requests that a page would like to send: a higher force, Overdrive Mode, a motion and a FAST STOP.
const UNWANTED: [u8; 4] = [0x32, 0x37, 0x20, 0x23];

fn unwanted() -> Vec<u8> {
    [request(0x32, &floats(&[80.0])), request(0x37, &[1]), request(0x20, &[0]), request(0x23, &[])].concat()
}

/// Bytes with which a browser or another program begins, each followed by `body`.
fn foreign(body: &[u8]) -> Vec<Vec<u8>> {
    let length = body.len();
    let post = format!(
        "POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://evil.example\r\nContent-Type: text/plain\r\n\
         Content-Length: {length}\r\n\r\n"
    );
    let socket = "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
                  Origin: http://evil.example\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAA\r\n\r\n";
    let hello: &[u8] = &[0x16, 0x03, 0x01, 0x02, 0x00, 0x01, 0x00, 0x01, 0xFC, 0x03, 0x03];
    // TURN over TCP, whose attributes a page can choose.
    let allocate: &[u8] = &[0x00, 0x03, 0x00, 0x40, 0x21, 0x12, 0xA4, 0x42];
    let beginnings = [post.as_bytes(), socket.as_bytes(), hello, b"SSH-2.0-OpenSSH_9.9\r\n", b"?", allocate];
    beginnings.iter().map(|beginning| [beginning, body].concat()).collect()
}

/// Sends bytes, and waits until the port has closed the connection.
async fn closes(address: SocketAddr, bytes: &[u8]) {
    let mut stream = TcpStream::connect(address).await.unwrap();
    // The port may close the connection first.
    let _ = stream.write_all(bytes).await;
    let mut received = [0; 64];
    let read = tokio::time::timeout(DEADLINE, stream.read(&mut received)).await;
    let read = read.unwrap_or_else(|_| panic!("not closed: {bytes:x?}"));
    assert!(matches!(read, Ok(0) | Err(_)), "answered: {:x?}", &received[..read.unwrap_or(0)]);
}

fn obeyed(proxy: &Proxy) -> Vec<u8> {
    let ids = proxy.frames.all().into_iter().map(|frame| frame.id);
    ids.filter(|id| UNWANTED.contains(id)).collect()
}

#[tokio::test]
async fn wsg_port_obeys_no_web_page() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gripper = format!("p=tcp://{}", proxy.address);
    let port = ["--gripper", &gripper, "--wsg-port", "p=127.0.0.1:0"];
    let (gateway, _) = Gateway::guarded(&["--name boss --role supervisor"], &port).await;
    let port: SocketAddr = gateway.word_after("WSG port of p: tcp://").await.parse().unwrap();
    eventually("p is connected", async || {
        let state = gateway.get("/api/v1/grippers/p/state").await.ok();
        (state["link"] == "connected").then_some(())
    })
    .await;
    for bytes in foreign(&unwanted()) {
        closes(port, &bytes).await;
        // In pieces, as a slow client sends them.
        let mut stream = TcpStream::connect(port).await.unwrap();
        stream.write_all(&bytes[..1]).await.unwrap();
        let _ = stream.write_all(&bytes[1..]).await;
        assert!(matches!(stream.read(&mut [0; 8]).await, Ok(0) | Err(_)));
    }
    // A request of a driver comes after everything that a page could have caused.
    let mut driver = Driver::connect(port).await;
    assert_eq!(driver.status(0x06, b"after").await, 0);
    assert_eq!(obeyed(&proxy), [0_u8; 0]);
    let figures = gateway.figures().await;
    for (protocol, least) in [("http", 2.0), ("tls", 1.0), ("ssh", 1.0), ("other", 2.0)] {
        let series = format!("wsg_foreign_clients_total{{door=\"wsg\",protocol=\"{protocol}\"}}");
        assert!(figures.get(&series).is_some_and(|count| *count >= least), "{series}: {figures:?}");
    }
    gateway.until_logged("its bytes belong to another protocol").await;
    gateway.until_logged("web page").await;
}

#[tokio::test]
async fn frame_behind_a_little_noise_is_obeyed() {
    for evaluation in [true, false] {
        let text = format!(
            "[grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = [\"127.0.0.1:0\", \"udp://127.0.0.1:0?reply_port=sender\"]\n\
             wsg_port_checksum_evaluation = {evaluation}\n"
        );
        let gateway = Gateway::with_file(&[], &text).await;
        gateway.until_link("connected").await;
        let tcp: SocketAddr = gateway.word_after("WSG port of g: tcp://").await.parse().unwrap();
        let udp: SocketAddr = gateway.word_after("WSG port of g: udp://").await.parse().unwrap();
        let mut frame = request(0x06, b"x");
        if !evaluation {
            // Some drivers send zeros.
            let end = frame.len();
            frame[end - 2..].fill(0);
        }
        let noises: [&[u8]; 6] = [&[], &[0x00], &[0xFF; 4], &[0xAA; 7], &[0x00, 0xAA, 0xFF, 0xAA], &[0x00; 16]];
        for noise in noises {
            let bytes = [noise, &frame].concat();
            let mut driver = Driver::connect(tcp).await;
            driver.send_raw(&bytes).await;
            assert_eq!(driver.next().await.data, b"x", "behind {noise:x?}");
            let mut slow = Driver::connect(tcp).await;
            for byte in &bytes {
                slow.send_raw(&[*byte]).await;
            }
            assert_eq!(slow.next().await.data, b"x", "behind {noise:x?}, byte by byte");
            let client = UdpSocket::bind("127.0.0.1:0").await.unwrap();
            client.send_to(&bytes, udp).await.unwrap();
            let mut answer = [0; 64];
            let read = tokio::time::timeout(DEADLINE, client.recv(&mut answer)).await.expect("an answer").unwrap();
            assert_eq!(&answer[3..read - 2], &[0x06, 3, 0, 0, 0, b'x'], "behind {noise:x?}");
        }
    }
}

#[tokio::test]
async fn datagrams_without_a_frame_at_their_start_are_ignored() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gripper = format!("g=tcp://{}", proxy.address);
    let receiver = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let port = format!("g=udp://127.0.0.1:0?reply_port={}", receiver.local_addr().unwrap().port());
    let gateway = Gateway::start(&["--gripper", &gripper, "--wsg-port", &port]).await;
    gateway.until_link("connected").await;
    let port: SocketAddr = gateway.word_after("WSG port of g: udp://").await.parse().unwrap();
    let page = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let driver = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    let mut answer = [0; 64];
    // With a fixed reply port, the driver and the page count as one client.
    for _ in 0..2 {
        for bytes in foreign(&unwanted()) {
            page.send_to(&bytes, port).await.unwrap();
        }
        driver.send_to(&request(0x06, b"x"), port).await.unwrap();
        let read = tokio::time::timeout(DEADLINE, receiver.recv(&mut answer)).await.expect("an answer").unwrap();
        assert_eq!(&answer[3..read - 2], &[0x06, 3, 0, 0, 0, b'x']);
    }
    assert_eq!(obeyed(&proxy), [0_u8; 0]);
    gateway.until_logged("they do not begin with a frame").await;
}

#[tokio::test]
async fn modbus_obeys_no_web_page() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let toml = format!("[grippers.g]\nurl = \"tcp://{}\"\n", proxy.address);
    let gateway = Gateway::with_file(&["--modbus", "127.0.0.1:0"], &toml).await;
    gateway.until_link("connected").await;
    let address: SocketAddr = gateway.word_after("Modbus: ").await.parse().unwrap();
    // Unit 1: homing by the command registers, and a FAST STOP.
    let home = hex::decode("00010000000B0110006400020400010001").unwrap();
    let fast_stop = hex::decode("0002000000060106006E0001").unwrap();
    let body = [home, fast_stop.clone()].concat();
    for bytes in foreign(&body) {
        // A single byte can be the beginning of a Modbus header.
        if bytes[0] != b'?' {
            closes(address, &bytes).await;
        }
    }
    // A header with the length of a request, but of another protocol.
    let other = hex::decode("1603010200020101").unwrap();
    closes(address, &[other, fast_stop].concat()).await;
    let mut reader = TcpStream::connect(address).await.unwrap();
    reader.write_all(&hex::decode("000200000006010400640001").unwrap()).await.unwrap();
    tokio::time::timeout(DEADLINE, reader.read_exact(&mut [0; 11])).await.expect("an answer").unwrap();
    assert_eq!(obeyed(&proxy), [0_u8; 0]);
    let series = "wsg_foreign_clients_total{door=\"modbus\",protocol=\"http\"}";
    assert_eq!(gateway.figures().await.get(series), Some(&2.0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn zenoh_obeys_no_web_page() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    let endpoint = gateway.word_after("Zenoh: ").await;
    let address: SocketAddr = endpoint.strip_prefix("tcp/").unwrap().parse().unwrap();
    for bytes in foreign(b"wsg/v1/fast-stop") {
        let mut stream = TcpStream::connect(address).await.unwrap();
        let _ = stream.write_all(&bytes).await;
        // Zenoh may wait for the rest of a message whose length it has read from these bytes.
        drop(stream);
    }
    let client = ZenohClient::of(&gateway).await;
    let states = client.all("wsg/v1/gateway/g/state", "").await;
    assert_eq!(states.len(), 1, "{states:?}");
    assert_eq!(obeyed(&proxy), [0_u8; 0]);
    assert_eq!(gateway.state().await["fast_stop"], false);
}

#[tokio::test]
async fn simulator_obeys_no_web_page() {
    let (device, url) = Simulator::with_control().await;
    let http = reqwest::Client::new();
    let received = async || {
        let shown: serde_json::Value = http.get(&url).send().await.unwrap().json().await.unwrap();
        shown["received_frames"].clone()
    };
    for bytes in foreign(&unwanted()) {
        closes(device.address, &bytes).await;
    }
    assert_eq!(received().await, 0);
    let mut driver = Driver::connect(device.address).await;
    // The connections of the page ended without an announcement, like any.
    assert_eq!(driver.status(0x24, b"ack").await, 0);
    driver.send_raw(&[&[0x00, 0xAA][..], &request(0x20, &[0])].concat()).await;
    assert_eq!(driver.next().await.status, PENDING);
}

#[tokio::test]
async fn control_port_refuses_web_pages() {
    let (_device, url) = Simulator::with_control().await;
    let http = reqwest::Client::new();
    let post = |name: &'static str, value: &'static str| http.post(&url).header(name, value).body(r#""release_part""#);
    for (name, value) in [("Origin", "http://evil.example"), ("Origin", "null"), ("Host", "evil.example")] {
        assert_eq!(post(name, value).send().await.unwrap().status(), 403, "{name}: {value}");
    }
    let own = http.post(&url).body(r#"{"place_part": {"width_mm": 20}}"#);
    assert_eq!(own.send().await.unwrap().status(), 200);
}
