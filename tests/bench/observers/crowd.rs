//! The observers.

use std::io::BufRead;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use rumqttc::{AsyncClient, Event, MqttOptions, Packet, QoS};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;

use super::Error;
use super::socket::{Socket, connect};
use super::variables::number;

/// A telemetry notification, as long as the gateway's.
const PAYLOAD: &str = r#"{"jsonrpc":"2.0","method":"telemetry","params":{"gripper":"g","seq":12345,"at":"2026-11-21T16:00:00.123Z","width_mm":null,"speed_mm_s":0.0,"force_n":0.0,"state":"IDLE","flags_raw":262144}}"#;

/// Requests of the flood in flight.
const UNDER_WAY: usize = 8;

/// Time that a stalled observer stays, which is the gateway's limit.
const STALLS_FOR: Duration = Duration::from_secs(3);

/// Pause before a rejected observer retries.
const AGAIN_AFTER: Duration = Duration::from_millis(100);

/// Receive buffer of a stalled observer, small enough to block the gateway's writes.
const STALLED_BYTES: u32 = 4096;

#[derive(Default)]
struct Seen {
    ready: AtomicU64,
    delivered: AtomicU64,
    refused: AtomicU64,
    /// Newest event that any observer has.
    newest: AtomicI64,
    /// For each observer, the newest event without a gap before it.
    all_until: Vec<AtomicI64>,
}

/// Input line that starts the stalled observers and the flood.
pub const DISTURB: &str = "disturb";

/// Runs the observers, and prints one report per input line, starting once all are connected.
pub fn run(what: &str, address: &str) -> Result<(), Error> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let (observers, stalled) = (number("OBSERVERS", 1000), number("STALLED", 100));
    let healthy = observers - stalled;
    let seen = Arc::new(Seen { all_until: (0..healthy).map(|_| AtomicI64::new(0)).collect(), ..Seen::default() });
    for index in 0..healthy {
        let (seen, address) = (seen.clone(), address.to_owned());
        match what {
            "mqtt" => drop(runtime.spawn(async move { tell("subscriber", &subscriber(index, &address, &seen).await) })),
            _ => drop(runtime.spawn(async move { tell("observer", &observer(index, &address, &seen).await) })),
        }
        // Slowly enough for the listener's backlog.
        std::thread::sleep(Duration::from_millis(2));
    }
    if what == "mqtt" {
        let address = address.to_owned();
        runtime.spawn(async move { tell("publisher", &publisher(&address).await) });
    }
    while seen.ready.load(Ordering::Relaxed) < healthy as u64 {
        std::thread::sleep(Duration::from_millis(10));
    }
    for line in std::io::stdin().lock().lines() {
        if line? == DISTURB {
            for _ in 0..stalled {
                let address = address.to_owned();
                runtime.spawn(async move { tell("stalled observer", &staller(&address).await) });
            }
            let (seen, address) = (seen.clone(), address.to_owned());
            runtime.spawn(async move { tell("flood", &flood(&address, &seen).await) });
        }
        let newest = seen.newest.load(Ordering::Relaxed);
        let complete = seen.all_until.iter().filter(|until| until.load(Ordering::Relaxed) == newest).count();
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        println!(
            "{}",
            json!({"delivered": count(&seen.delivered), "complete": complete, "incomplete": healthy - complete,
                "refused": count(&seen.refused)})
        );
    }
    Ok(())
}

fn tell(role: &str, ended: &Result<(), Error>) {
    eprintln!("{role} ended: {ended:?}");
}

async fn subscribe(socket: &mut Socket) -> Result<i64, Error> {
    let params = json!({"topics": ["telemetry", "events"], "max_hz": number("HZ", 50)});
    let request = json!({"jsonrpc": "2.0", "id": 1, "method": "subscribe", "params": params});
    socket.send(Message::text(request.to_string())).await?;
    let answer = socket.next().await.ok_or("no answer")??;
    let answer: Value = serde_json::from_str(answer.to_text()?).unwrap_or_default();
    Ok(answer["result"]["event_seq"].as_i64().unwrap_or_default())
}

async fn observer(index: usize, address: &str, seen: &Seen) -> Result<(), Error> {
    let mut socket = connect(address, None).await?;
    let mut last = loop {
        // A ping can come first.
        let seq = subscribe(&mut socket).await?;
        if seq > 0 {
            break seq;
        }
    };
    seen.ready.fetch_add(1, Ordering::Relaxed);
    seen.all_until[index].store(last, Ordering::Relaxed);
    while let Some(message) = socket.next().await {
        let Message::Text(text) = message? else { continue };
        seen.delivered.fetch_add(1, Ordering::Relaxed);
        if !text.contains(r#""method":"event""#) {
            continue;
        }
        let event: Value = serde_json::from_str(&text)?;
        let seq = event["params"]["seq"].as_i64().ok_or("no seq")?;
        if seq == last + 1 {
            seen.all_until[index].store(seq, Ordering::Relaxed);
            last = seq;
        }
        seen.newest.fetch_max(seq, Ordering::Relaxed);
    }
    Ok(())
}

async fn staller(address: &str) -> Result<(), Error> {
    loop {
        // All slots can be taken until the gateway has closed the previous connection.
        let Ok(mut socket) = connect(address, Some(STALLED_BYTES)).await else {
            tokio::time::sleep(AGAIN_AFTER).await;
            continue;
        };
        subscribe(&mut socket).await?;
        tokio::time::sleep(STALLS_FOR).await;
    }
}

async fn flood(address: &str, seen: &Seen) -> Result<(), Error> {
    let mut socket = connect(address, None).await?;
    let params = json!({"gripper": "g", "width_mm": 5000, "speed_mm_s": 50});
    let request = json!({"jsonrpc": "2.0", "id": 1, "method": "move", "params": params}).to_string();
    for _ in 0..UNDER_WAY {
        socket.send(Message::text(request.clone())).await?;
    }
    while let Some(message) = socket.next().await {
        if message?.is_text() {
            seen.refused.fetch_add(1, Ordering::Relaxed);
            socket.send(Message::text(request.clone())).await?;
        }
    }
    Ok(())
}

fn options(name: &str, address: &str) -> Result<MqttOptions, Error> {
    let (host, port) = address.split_once(':').ok_or("no port")?;
    Ok(MqttOptions::new(name, host, port.parse()?))
}

async fn subscriber(index: usize, address: &str, seen: &Seen) -> Result<(), Error> {
    let (client, mut events) = AsyncClient::new(options(&format!("s{index}"), address)?, 10);
    client.subscribe("telemetry", QoS::AtMostOnce).await?;
    loop {
        match events.poll().await? {
            Event::Incoming(Packet::SubAck(_)) => drop(seen.ready.fetch_add(1, Ordering::Relaxed)),
            Event::Incoming(Packet::Publish(_)) => drop(seen.delivered.fetch_add(1, Ordering::Relaxed)),
            _ => {}
        }
    }
}

async fn publisher(address: &str) -> Result<(), Error> {
    let (client, mut events) = AsyncClient::new(options("publisher", address)?, 10);
    let mut ticks = tokio::time::interval(Duration::from_secs(1) / number("HZ", 50) as u32);
    loop {
        tokio::select! {
            event = events.poll() => drop(event?),
            _ = ticks.tick() => client.publish("telemetry", QoS::AtMostOnce, false, PAYLOAD).await?,
        }
    }
}
