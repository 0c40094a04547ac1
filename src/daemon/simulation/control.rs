//! The control port, which injects faults into simulated devices over HTTP, to test a gateway against a misbehaving
//! gripper.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::ensure;
use axum::body::Bytes;
use axum::extract::{Path, Request, State};
use axum::http::StatusCode;
use axum::middleware::{Next, from_fn};
use axum::response::Response;
use axum::routing::get;
use axum::{Json, Router};
use serde::Serialize;
use tokio::net::TcpListener;

use super::super::listen::failed;
use super::ServedDevice;
use crate::interfaces::http::{HttpSettings, check_host_and_origin};
use crate::sim::{Change, Part, Snapshot};

/// The true state of a device, which can differ from the state that it reports.
#[derive(Debug, Serialize)]
#[allow(clippy::struct_excessive_bools, reason = "a snapshot of states that are independent")]
struct Shown {
    address: String,
    model: &'static str,
    state: &'static str,
    flags: Vec<&'static str>,
    true_width_mm: f64,
    speed_mm_s: f64,
    force_n: f64,
    temperature_c: f64,
    referenced: bool,
    moving: bool,
    fast_stop: bool,
    part: Option<Part>,
    obstacle_mm: Option<f64>,
    connected: bool,
    booting: bool,
    silent: bool,
    half_open: bool,
    received_frames: u64,
    damaged_requests: u64,
}

impl Shown {
    fn new(served: &ServedDevice, snapshot: &Snapshot) -> Self {
        Self {
            address: served.address.to_string(),
            model: served.model,
            state: snapshot.gripper_state.name(),
            flags: snapshot.flags.names().collect(),
            true_width_mm: snapshot.true_width_mm,
            speed_mm_s: snapshot.speed_mm_s,
            force_n: snapshot.force_n,
            temperature_c: snapshot.temperature_c,
            referenced: snapshot.referenced,
            moving: snapshot.moving,
            fast_stop: snapshot.fast_stop,
            part: snapshot.part,
            obstacle_mm: snapshot.obstacle_mm,
            connected: snapshot.connected,
            booting: snapshot.booting,
            silent: snapshot.silent,
            half_open: snapshot.half_open,
            received_frames: snapshot.received_frames,
            damaged_requests: snapshot.damaged_requests,
        }
    }
}

type Devices = State<Arc<Vec<ServedDevice>>>;
type Refusal = (StatusCode, String);

/// Listens on a loopback address, since the port has no credentials.
pub(super) async fn listen(address: SocketAddr) -> anyhow::Result<TcpListener> {
    ensure!(address.ip().is_loopback(), "--control {address} must be a loopback address: the port has no credentials");
    let listener = TcpListener::bind(address).await;
    listener.map_err(|error| failed(format_args!("--control: cannot listen on {address}"), error))
}

/// Serves until it is cancelled.
pub(super) async fn serve(listener: TcpListener, devices: Vec<ServedDevice>) -> anyhow::Result<()> {
    let router = Router::new()
        .route("/devices", get(show_all))
        .route("/devices/{index}", get(show).post(change))
        .layer(from_fn(refuse_pages))
        .with_state(Arc::new(devices));
    Ok(axum::serve(listener, router).await?)
}

/// Refuses the requests of web pages, since any page can post a change.
async fn refuse_pages(request: Request, next: Next) -> Response {
    check_host_and_origin(&HttpSettings::default(), request, async |request| next.run(request).await).await
}

async fn show_all(State(devices): Devices) -> Result<Json<Vec<Shown>>, Refusal> {
    let mut all = Vec::new();
    for served in devices.iter() {
        all.push(shown(served).await?);
    }
    Ok(Json(all))
}

async fn show(State(devices): Devices, Path(index): Path<usize>) -> Result<Json<Shown>, Refusal> {
    shown(find(&devices, index)?).await.map(Json)
}

/// Accepts any content type, since requests are typed by hand.
async fn change(State(devices): Devices, Path(index): Path<usize>, body: Bytes) -> Result<Json<Shown>, Refusal> {
    let served = find(&devices, index)?;
    let change: Change = serde_json::from_slice(&body).map_err(|error| {
        (StatusCode::BAD_REQUEST, format!("{error}: write it as {{\"silent\": {{\"on\": true}}}}\n"))
    })?;
    served.switch.apply(change).await.map_err(|error| match error.kind() {
        ErrorKind::InvalidInput => (StatusCode::UNPROCESSABLE_ENTITY, format!("{error}\n")),
        _ => gone(error),
    })?;
    shown(served).await.map(Json)
}

fn find(devices: &[ServedDevice], index: usize) -> Result<&ServedDevice, Refusal> {
    devices.get(index).ok_or_else(|| {
        let detail = format!("no device {index}: there are {}, counted from 0\n", devices.len());
        (StatusCode::NOT_FOUND, detail)
    })
}

async fn shown(served: &ServedDevice) -> Result<Shown, Refusal> {
    Ok(Shown::new(served, &served.switch.snapshot().await.map_err(gone)?))
}

#[allow(clippy::needless_pass_by_value, reason = "for map_err")]
fn gone(error: std::io::Error) -> Refusal {
    (StatusCode::SERVICE_UNAVAILABLE, format!("{error}\n"))
}
