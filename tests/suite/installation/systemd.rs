//! The gateway as a service of systemd. The test plays the part of systemd.

use std::fs::File;
use std::os::linux::fs::MetadataExt as _;
use std::process::{Command, Stdio};

use tokio::net::UnixDatagram;
use tokio::time::timeout;

use crate::harness::child::{Child, Signal};
use crate::harness::{DEADLINE, Directory};

/// Receives the next message of this name.
async fn until(socket: &UnixDatagram, name: &str) {
    let received = async {
        let mut buffer = [0; 256];
        loop {
            let length = socket.recv(&mut buffer).await.unwrap();
            if String::from_utf8_lossy(&buffer[..length]).lines().any(|line| line == name) {
                break;
            }
        }
    };
    assert!(timeout(DEADLINE, received).await.is_ok(), "no {name} within {DEADLINE:?}");
}

#[tokio::test]
async fn service_is_ready_feeds_the_watchdog_and_logs_priorities() {
    let files = Directory::new();
    let (notify, log) = (files.file("notify"), files.file("log"));
    let socket = UnixDatagram::bind(&notify).unwrap();
    let file = File::create(&log).unwrap();
    let metadata = file.metadata().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_wsg-gateway"));
    command
        .args(["--listen", "127.0.0.1:0", "--zenoh-mode", "off", "--journal", ":memory:"])
        .args(["--gripper", "g=sim://wsg50"])
        .env("NOTIFY_SOCKET", &notify)
        .env("WATCHDOG_USEC", "200000")
        .env("JOURNAL_STREAM", format!("{}:{}", metadata.st_dev(), metadata.st_ino()))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(file);
    let (mut service, ..) = Child::start(&mut command);
    until(&socket, "READY=1").await;
    until(&socket, "WATCHDOG=1").await;
    until(&socket, "WATCHDOG=1").await;
    service.signal(Signal::TERM);
    until(&socket, "STOPPING=1").await;
    let ended = service.ended().await;
    let log = std::fs::read_to_string(&log).unwrap();
    assert!(ended.success(), "{log}");
    assert!(!log.is_empty() && log.lines().all(|line| line.starts_with("<6>")), "{log}");
}
