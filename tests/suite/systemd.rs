//! The gateway as a service of systemd. The test plays the part of systemd.

use std::fs::File;
use std::os::linux::fs::MetadataExt as _;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use tokio::net::UnixDatagram;

use crate::harness::child::{Child, Signal};
use crate::harness::eventually;

/// Receives the next message of this name.
async fn until(socket: &UnixDatagram, name: &str) {
    let received = async || {
        let mut buffer = [0; 256];
        let length = socket.recv(&mut buffer).await.ok()?;
        String::from_utf8_lossy(&buffer[..length]).lines().any(|line| line == name).then_some(())
    };
    eventually(name, received).await;
}

#[tokio::test]
async fn service_is_ready_feeds_the_watchdog_and_logs_priorities() {
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-systemd", std::process::id()));
    std::fs::create_dir_all(&directory).unwrap();
    let (notify, log) = (directory.join("notify"), directory.join("log"));
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
    std::fs::remove_dir_all(&directory).unwrap();
    assert!(ended.success(), "{log}");
    assert!(!log.is_empty() && log.lines().all(|line| line.starts_with("<6>")), "{log}");
}
