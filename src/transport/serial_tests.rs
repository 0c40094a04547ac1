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
    address(path, 9600).connect().await.unwrap();
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
