use tokio::net::{TcpListener, TcpSocket};

use super::*;

/// Texts that the system's resolver or a URL parser reads as an address, and some that it refuses much later.
const NOT_PLAIN: [&str; 10] = [
    "192.168.001.020",
    "127.1",
    "0x7f.0.0.8",
    "127.0.0.0x8",
    "0X7F000001",
    "2130706440",
    "192.168.1.300",
    "1.2.3.4.5",
    "127.0.0.1.",
    "08.8.8.8",
];

#[test]
fn host_that_looks_like_an_address_must_be_one() {
    for host in NOT_PLAIN {
        let error = check_host(host).unwrap_err().to_string();
        assert!(error.contains(host) && error.contains("such as 192.168.1.20"), "{error}");
    }
    for host in ["192.168.1.20", "0.0.0.0", "gripper", "gripper-7", "7.cell.example", "0x7f.example", "gripper.7a"] {
        assert_eq!(check_host(host), Ok(()), "{host}");
    }
}

#[test]
fn network_has_a_plain_address() {
    let error = check_network("192.168.010.0/24").unwrap_err().to_string();
    assert!(error.contains("\"192.168.010.0\"") && error.contains("without leading zeros"), "{error}");
    for network in ["192.168.10.0/24", "10.0.0.7", "2001:db8::/32", "::1", "::ffff:192.168.1.10"] {
        assert_eq!(check_network(network), Ok(()), "{network}");
    }
}

#[test]
fn web_url_has_its_host_as_written() {
    for host in NOT_PLAIN.into_iter().chain(["１２７.0.0.1", "127.0.0.%31"]) {
        for url in [format!("http://{host}"), format!("https://{host}:8443/a?b#c"), format!("http://me@{host}/")] {
            let error = parse_web_url(&url).unwrap_err().to_string();
            assert!(error.starts_with("has the host") || error.starts_with("is not a valid URL"), "{url}: {error}");
        }
    }
    for text in [
        "http://192.168.1.20",
        "https://user@192.168.1.20:8443/hook",
        "http://[::1]:80/",
        "https://mes.example/127.1",
        "http://mes.example?to=127.1",
        "ws://localhost:8080",
    ] {
        assert_eq!(parse_web_url(text), Ok(text.parse().unwrap()), "{text}");
    }
    assert!(parse_web_url("mes").unwrap_err().to_string().starts_with("is not a valid URL"));
}

#[tokio::test]
async fn zone_is_resolved_to_its_interface() {
    let [SocketAddr::V6(address)] = resolve("fe80::1%lo", 1000, Duration::from_secs(3)).await.unwrap()[..] else {
        panic!("not one IPv6 address");
    };
    assert_eq!((address.ip().to_string().as_str(), address.scope_id()), ("fe80::1", 1));
    let error = resolve("fe80::1%none9", 1000, Duration::from_secs(3)).await.unwrap_err().to_string();
    assert!(error.contains("network interface \"none9\""), "{error}");
}

/// An address that accepts no connection and refuses none: a listener whose queue is full.
async fn silent() -> (SocketAddr, Vec<TcpStream>, TcpListener) {
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let listener = socket.listen(0).unwrap();
    let address = listener.local_addr().unwrap();
    let mut waiting = Vec::new();
    while let Ok(Ok(stream)) = timeout(Duration::from_millis(200), TcpStream::connect(address)).await {
        waiting.push(stream);
    }
    (address, waiting, listener)
}

#[tokio::test]
async fn silent_address_leaves_time_for_the_next_one() {
    let (silent, _waiting, _socket) = silent().await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let begun = Instant::now();
    let stream = connect_to_first(&[silent, address], Duration::from_secs(1)).await.unwrap();
    assert_eq!(stream.peer_addr().unwrap(), address);
    assert!(begun.elapsed() >= Duration::from_millis(400), "{:?}", begun.elapsed());
}

#[tokio::test]
async fn error_names_each_address() {
    let (silent, _waiting, _socket) = silent().await;
    let refusing: SocketAddr = "127.0.0.2:1".parse().unwrap();
    let error = connect_to_first(&[refusing, silent], Duration::from_millis(300)).await.unwrap_err();
    let text = error.to_string();
    assert!(text.starts_with("127.0.0.2: ") && text.contains("; 127.0.0.1: no connection within 0.3 s"), "{text}");
    assert_eq!(error.kind(), io::ErrorKind::TimedOut);
    let alone = connect_to_first(&[silent], Duration::from_millis(200)).await.unwrap_err().to_string();
    assert_eq!(alone, "no connection within 0.2 s");
}
