//! Cost of the session: frames per second, and allocations per frame (none in steady state).
//!
//! `cargo bench --bench session`. The `alloc` rows count the allocations of one sample of 1,000 frames.

use std::hint::black_box;
use std::time::{Duration, Instant};

use divan::counter::{BytesCount, ItemsCount};
use divan::{AllocProfiler, Bencher};
use wsg_gateway::wsg::session::{Request, Session, SessionConfig};
use wsg_gateway::wsg::{Command, Data, Force, GripperState, Reply, Speed, SystemState, Width, id};

#[global_allocator]
static ALLOCATOR: AllocProfiler = AllocProfiler::system();

/// Frames of one sample.
const FRAMES: usize = 1000;

/// Frames per chunk, as a device with all updates on delivers them to a socket.
const CHUNK_FRAMES: usize = 5;

fn main() {
    divan::main();
}

fn session() -> Session {
    let config = SessionConfig {
        bytes_per_second: None,
        frame_gap: Duration::from_millis(500),
        may_duplicate: false,
        nonce_seed: 1,
    };
    Session::new(config, Instant::now())
}

fn quantity<T>(value: Result<T, wsg_gateway::wsg::NotFinite>) -> T {
    value.unwrap_or_else(|error| unreachable!("{error}"))
}

fn updates() -> Vec<u8> {
    let updates = [
        (id::GET_SYSTEM_STATE, Data::SystemState(SystemState::REFERENCED)),
        (id::GET_GRIPPER_STATE, Data::GripperState(GripperState::Holding)),
        (id::GET_WIDTH, Data::Width(quantity(Width::new(20.0)))),
        (id::GET_SPEED, Data::Speed(quantity(Speed::new(0.0)))),
        (id::GET_FORCE, Data::Force(quantity(Force::new(40.0)))),
    ];
    let mut bytes = Vec::new();
    for (id, data) in updates.into_iter().cycle().take(CHUNK_FRAMES) {
        Reply::Success(data).encode(id, &mut bytes);
    }
    bytes
}

/// Automatic updates, from bytes to events.
#[divan::bench]
fn decode_updates(bencher: Bencher) {
    let chunk = updates();
    let mut session = session();
    let now = Instant::now();
    let bytes = BytesCount::new(chunk.len() * FRAMES / CHUNK_FRAMES);
    bencher.counter(ItemsCount::new(FRAMES)).counter(bytes).bench_local(|| {
        for _ in 0..FRAMES / CHUNK_FRAMES {
            session.receive(now, black_box(&chunk));
            while let Some(event) = session.poll_event() {
                black_box(event);
            }
        }
    });
}

/// Requests, from values to bytes.
#[divan::bench]
fn encode_grips(bencher: Bencher) {
    let grip = Command::Grip { width: quantity(Width::new(20.0)), speed: quantity(Speed::new(50.0)) };
    let mut frame = Vec::with_capacity(64);
    bencher.counter(ItemsCount::new(FRAMES)).bench_local(|| {
        for _ in 0..FRAMES {
            frame.clear();
            black_box(&grip).encode(&mut frame);
            black_box(&frame);
        }
    });
}

/// A request and its reply: submit, transmit, receive, event.
#[divan::bench]
fn requests_and_replies(bencher: Bencher) {
    let mut session = session();
    let now = Instant::now();
    let mut reply = Vec::new();
    Reply::Success(Data::ForceLimit(quantity(Force::new(40.0)))).encode(id::GET_FORCE_LIMIT, &mut reply);
    let mut frame = Vec::with_capacity(64);
    let limit = Duration::from_secs(1);
    bencher.counter(ItemsCount::new(FRAMES)).bench_local(|| {
        for _ in 0..FRAMES {
            let request = Request { command: Command::GetForceLimit, reply_within: limit, result_within: limit };
            let _ = black_box(session.submit(now, request));
            frame.clear();
            session.poll_transmit(now, &mut frame);
            session.receive(now, &reply);
            while let Some(event) = session.poll_event() {
                black_box(event);
            }
        }
    });
}
