//! A second device implementation beside the simulator. It shares no code with the crate, and answers every request
//! from a table.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;

use super::frames::Frames;

/// Period of updates once any are on.
pub(super) const UPDATE_EVERY: Duration = Duration::from_millis(10);

/// Payloads that answer each id, one frame each. An empty list is silence.
pub type Table = BTreeMap<u8, Vec<Vec<u8>>>;

/// Payload of a reply with `E_SUCCESS`.
pub fn success(data: &[u8]) -> Vec<u8> {
    [&[0, 0], data].concat()
}

/// A scripted device that serves one client at a time.
#[derive(Debug)]
pub struct Scripted {
    pub address: SocketAddr,
    /// Frames that the device received.
    pub frames: Frames,
    table: Arc<Mutex<Table>>,
    serving: JoinHandle<()>,
}

impl Scripted {
    /// Starts an idle, referenced WSG 50 at 50 mm; entries of `table` override its answers.
    pub async fn start(table: Table) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let table = Arc::new(Mutex::new(idle().into_iter().chain(table).collect()));
        let frames = Frames::default();
        let serving = tokio::spawn(serve(listener, table.clone(), frames.clone()));
        Self { address, frames, table, serving }
    }

    /// Answers this id with these payloads from now on.
    pub fn answer(&self, id: u8, payloads: Vec<Vec<u8>>) {
        self.table.lock().unwrap().insert(id, payloads);
    }

    /// Reports these system state flags from now on.
    pub fn flags(&self, flags: u32) {
        self.answer(0x40, vec![success(&flags.to_le_bytes())]);
    }
}

impl Drop for Scripted {
    fn drop(&mut self) {
        self.serving.abort();
    }
}

pub(super) fn idle() -> Table {
    let floats = |values: &[f32]| success(&values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>());
    let answers = [
        (0x07, success(&[])),
        (0x22, success(&[])),
        (0x23, success(&[])),
        (0x24, success(&[])),
        (0x35, vec![1, 0]),
        (0x40, success(&1_u32.to_le_bytes())),
        (0x41, success(&[0])),
        (0x43, floats(&[50.0])),
        (0x44, floats(&[0.0])),
        (0x45, floats(&[0.0])),
        (0x46, success(&250_i16.to_le_bytes())),
        (0x50, success(&[1, 6, 0x20, 0x40, 0x67, 0x12, 0, 0])),
        (0x52, vec![1, 0]),
        (0x53, floats(&[110.0, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0])),
    ];
    answers.into_iter().map(|(id, payload)| (id, vec![payload])).collect()
}

async fn serve(listener: TcpListener, table: Arc<Mutex<Table>>, frames: Frames) {
    for connection in 0.. {
        let (stream, _) = listener.accept().await.unwrap();
        stream.set_nodelay(true).unwrap();
        // Serve the next client however this connection ends.
        let _ = serve_one(stream, &table, &frames, connection).await;
    }
}

async fn serve_one(
    mut stream: TcpStream,
    table: &Mutex<Table>,
    frames: &Frames,
    connection: usize,
) -> std::io::Result<()> {
    let mut recorder = frames.recorder(connection);
    let mut seen = frames.len();
    let mut updated = Vec::new();
    let mut buffer = [0; 4096];
    let mut tick = tokio::time::interval(UPDATE_EVERY);
    loop {
        let mut out = Vec::new();
        tokio::select! {
            bytes = stream.read(&mut buffer) => match bytes? {
                0 => return Ok(()),
                bytes => {
                    recorder.push(&buffer[..bytes]);
                    let received = frames.since(seen);
                    seen += received.len();
                    for frame in received {
                        answer(table, frame.id, &frame.payload, &mut out);
                        if matches!(frame.id, 0x40 | 0x41 | 0x43..=0x45) {
                            updated.push(frame.id);
                        }
                    }
                }
            },
            _ = tick.tick() => {
                updated.sort_unstable();
                updated.dedup();
                for &id in &updated {
                    answer(table, id, &[], &mut out);
                }
            }
        }
        stream.write_all(&out).await?;
    }
}

fn answer(table: &Mutex<Table>, id: u8, payload: &[u8], out: &mut Vec<u8>) {
    let echo = success(payload);
    match table.lock().unwrap().get(&id) {
        Some(payloads) => payloads.iter().for_each(|payload| frame(id, payload, out)),
        None if id == 0x06 => frame(id, &echo, out),
        None => frame(id, &[0x0E, 0], out),
    }
}

/// Appends a frame.
pub fn frame(id: u8, payload: &[u8], out: &mut Vec<u8>) {
    let size = u16::try_from(payload.len()).unwrap().to_le_bytes();
    let frame = [&[0xAA, 0xAA, 0xAA, id], &size[..], payload].concat();
    let checksum = frame.iter().fold(0xFFFF, |crc, &byte| table_entry((crc ^ u16::from(byte)) as u8) ^ (crc >> 8));
    out.extend(frame);
    out.extend(checksum.to_le_bytes());
}

/// Entry of the manual's CRC table, computed from its polynomial.
fn table_entry(index: u8) -> u16 {
    (0..8).fold(u16::from(index) << 8, |entry, _| if entry & 0x8000 == 0 { entry << 1 } else { (entry << 1) ^ 0x1021 })
}

#[test]
fn frame_matches_the_example_in_the_manual() {
    let mut out = Vec::new();
    frame(0x31, &[0, 0, 0, 0, 0x16, 0x43], &mut out);
    assert_eq!(hex::encode_upper(out), "AAAAAA3106000000000016431CAF");
}
