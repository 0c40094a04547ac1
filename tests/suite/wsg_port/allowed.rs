//! Allowed client addresses and listen addresses.

use tokio::io::AsyncReadExt;
use tokio::net::{TcpListener, TcpSocket, UdpSocket};

use super::{Driver, SUCCESS, configured};
use crate::harness::wsg::request;
use crate::harness::{DEADLINE, run};

#[tokio::test]
async fn only_allowed_addresses_can_connect() {
    let text = "[grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = [\"127.0.0.1:0\", \"udp://127.0.0.1:0?reply_port=sender\"]\n\
        wsg_port_allow = [\"127.0.0.2\", \"10.0.0.0/8\"]\n";
    let gateway = configured(text).await;
    let tcp: std::net::SocketAddr = gateway.word_after("WSG port of g: tcp://").await.parse().unwrap();
    let udp: std::net::SocketAddr = gateway.word_after("WSG port of g: udp://").await.parse().unwrap();

    let mut other = tokio::net::TcpStream::connect(tcp).await.unwrap();
    let end = tokio::time::timeout(DEADLINE, other.read(&mut [0; 16])).await.expect("the connection is closed");
    assert!(matches!(end, Ok(0) | Err(_)), "{end:?}");
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind("127.0.0.2:0".parse().unwrap()).unwrap();
    let mut driver = Driver::over(socket.connect(tcp).await.unwrap());
    assert_eq!(driver.status(0x50, &[]).await, SUCCESS);

    let (other, named) = (UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.2:0").await.unwrap());
    other.send_to(&request(0x50, &[]), udp).await.unwrap();
    named.send_to(&request(0x50, &[]), udp).await.unwrap();
    let mut answer = [0; 64];
    let read = tokio::time::timeout(DEADLINE, named.recv(&mut answer)).await.expect("an answer").unwrap();
    assert!(read > 8 && answer[3] == 0x50, "{answer:?}");
    assert!(other.try_recv(&mut answer).is_err(), "a client outside the list gets no answer");
}

#[tokio::test]
async fn occupied_port_is_a_startup_error() {
    let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let port = format!("left={address}");
    let ended = run(&["--listen", "127.0.0.1:0", "--wsg-port", &port]).await;
    assert!(!ended.status.success(), "{ended:?}");
    for part in ["--wsg-port", "left", &address, "choose another"] {
        assert!(ended.stderr.contains(part), "{part}: {}", ended.stderr);
    }
}

#[tokio::test]
async fn allowed_drivers_connect_to_non_loopback_addresses() {
    let text = "[grippers.g]\nurl = \"sim://wsg50\"\nwsg_port = \"0.0.0.0:0\"\n\
        wsg_port_allow = [\"127.0.0.0/8\"]\n";
    let gateway = configured(text).await;
    let everywhere = gateway.word_after("WSG port of g: tcp://0.0.0.0:").await;
    let address = format!("127.0.0.3:{everywhere}").parse().unwrap();
    assert_eq!(Driver::connect(address).await.status(0x50, &[]).await, SUCCESS);
}
