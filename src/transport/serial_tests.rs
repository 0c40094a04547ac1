use std::time::Instant;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{sleep, timeout};

use super::*;

/// Master of a pty, and the path of its slave.
fn pty() -> (std::fs::File, String) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    (std::fs::File::from(master), name)
}

fn address(path: String, baud: u32) -> SerialAddress {
    SerialAddress { path, baud, stop_bits: 1 }
}

#[tokio::test]
async fn bytes_pass_both_ways_unchanged() {
    let (mut master, path) = pty();
    let mut pipe = address(path, 115_200).connect().await.unwrap();
    let all: Vec<u8> = (0..=255).collect();
    pipe.writer.write_all(&all).await.unwrap();
    let mut received = vec![0; 256];
    io::Read::read_exact(&mut master, &mut received).unwrap();
    assert_eq!(received, all);
    io::Write::write_all(&mut master, &all).unwrap();
    pipe.reader.read_exact(&mut received).await.unwrap();
    assert_eq!(received, all);
}

#[tokio::test]
async fn flush_waits_for_the_line() {
    let (_master, path) = pty();
    let mut pipe = address(path, 9600).connect().await.unwrap();
    let mut shortest = Duration::MAX;
    // Other processes can only lengthen a measured time, so only the shortest one counts.
    for _ in 0..20 {
        let begun = Instant::now();
        pipe.writer.write_all(&[0; 48]).await.unwrap();
        shortest = shortest.min(begun.elapsed());
        pipe.writer.flush().await.unwrap();
        assert!(begun.elapsed() >= Duration::from_millis(50), "48 bytes at 960 a second: {:?}", begun.elapsed());
        if shortest < Duration::from_millis(25) {
            return;
        }
    }
    panic!("a write alone waits: {shortest:?}");
}

#[tokio::test]
async fn port_is_opened_exclusively() {
    let (_master, path) = pty();
    let first = address(path.clone(), 9600).connect().await.unwrap();
    let error = address(path.clone(), 9600).connect().await.unwrap_err().to_string();
    assert!(error.contains("is in use"), "{error}");
    drop(first);
    // A process that another test starts holds the lock, too, until it executes its program.
    let opened = async {
        while address(path.clone(), 9600).connect().await.is_err() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(Duration::from_secs(10), opened).await.unwrap();
}

/// After a SIGKILL, nothing else would end the exclusive access to a pty.
#[tokio::test]
async fn pty_is_locked_but_not_exclusive() {
    let (_master, path) = pty();
    // Exclusive access holds for unprivileged users.
    let uid = if rustix::process::geteuid().is_root() { 65_534 } else { rustix::process::geteuid().as_raw() };
    std::os::unix::fs::chown(&path, Some(uid), None).unwrap();
    let _open = address(path.clone(), 9600).connect().await.unwrap();
    let mut shell = std::process::Command::new("sh");
    std::os::unix::process::CommandExt::uid(&mut shell, uid);
    let opened = shell.arg("-c").arg(format!("exec 3<>{path}")).output().unwrap();
    assert!(opened.status.success(), "{opened:?}");
}

#[tokio::test]
async fn busy_pty_error_names_remedy() {
    let (_master, path) = pty();
    let link = std::env::temp_dir().join(format!("wsg busy {}", std::process::id())).display().to_string();
    std::os::unix::fs::symlink(&path, &link).unwrap();
    let error = address(link.clone(), 9600).explain(&io::ErrorKind::ResourceBusy.into()).to_string();
    std::fs::remove_file(&link).unwrap();
    assert!(error.contains("is in use") && error.contains("restart the program that provides it"), "{error}");
}

#[tokio::test]
async fn unplugged_adapter_gives_error_with_port_name() {
    let (master, path) = pty();
    let mut pipe = address(path.clone(), 9600).connect().await.unwrap();
    let pulling = async {
        sleep(Duration::from_millis(20)).await;
        drop(master);
    };
    let mut buffer = [0; 10];
    let (read, ()) = tokio::join!(timeout(Duration::from_secs(1), pipe.reader.read(&mut buffer)), pulling);
    let error = read.unwrap().unwrap_err().to_string();
    assert!(error.contains(&format!("{path} is gone")), "{error}");
    let error = pipe.writer.write_all(&[0]).await.unwrap_err().to_string();
    assert!(error.contains(&format!("{path} is gone")), "{error}");
}
