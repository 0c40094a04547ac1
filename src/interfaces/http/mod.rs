//! HTTP: REST under `/api/v1`, its OpenAPI document, and the page that shows it.
//!
//! The line that mounts a handler documents it, so the document can't fall behind: what is served is what is
//! described. A request passes, from the outside in: `guard` (who may ask at all), `body` (read within bounds, except
//! for FAST STOP, which waits for nothing), `extract` (everything parsed, every mistake a problem), its handler. The
//! handlers are in `grippers`, `motions`, `commands`, `fast_stop`, `settings`, `device`, `fingers`, `raw`, `journal`,
//! `stream`, `gateway`, `fleet` with `forwarded`, and `ws`, which calls the others by their names in `methods`; `watched` counts and logs all of it.

mod asyncapi;
mod body;
mod commands;
mod device;
mod docs;
mod errors;
mod extract;
mod fast_stop;
mod fingers;
mod fleet;
mod forwarded;
mod gateway;
mod grippers;
mod guard;
mod journal;
mod large;
mod lease;
mod methods;
mod motions;
mod pace;
mod parameters;
mod quick_ack;
mod raw;
mod refused;
mod responses;
mod server;
mod settings;
mod stream;
mod unique;
mod values;
mod watched;
mod ws;

use std::any::Any;
use std::sync::Arc;

use axum::http::Method as Verb;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Router, middleware};
use prometheus::Registry;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;
use utoipa::OpenApi as _;
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::dashboard;
use super::metrics::Metrics;
use super::refusals::Refusals;
use super::runtimes::Runtimes;
use crate::events::Updates;
use crate::fleet::Network;
use crate::gripper::Grippers;
use crate::gripper::model::Name;
use crate::journal::Journal;

pub use asyncapi::{document as asyncapi_document, yaml as asyncapi};
pub(super) use body::{MAX_BODY_BYTES, parse as parse_body};
pub(super) use errors::{Code, Problem};
pub(super) use extract::Presence;
pub(super) use lease::Taken;
pub(crate) use methods::{IDEMPOTENCY_KEY, METHODS, Method, Methods, Refusal, WSG_LEASE, Wait, is_fast_stop, urgency};
pub use server::{Limits, listen, serve};
pub(super) use unique::Unique;
pub use values::name as shown_name;

/// Where the API begins.
const API: &str = "/api/v1";

/// What the handlers share.
#[derive(Debug, Clone)]
pub struct Context {
    /// The gateway's name.
    pub gateway: Name,
    /// Its grippers.
    pub fleet: Grippers,
    /// What happened to them.
    pub journal: Journal,
    /// What was refused, on its way there.
    pub refusals: Arc<Refusals>,
    /// The other gateways.
    pub network: Arc<Network>,
    /// What can be followed live.
    pub updates: Arc<Updates>,
    /// Ends the streams when the gateway ends.
    pub closing: CancellationToken,
    /// Runtimes that serve clients.
    pub runtimes: Runtimes,
    /// What this door counts.
    pub metrics: Metrics,
    /// What WebSocket counts.
    pub ws_metrics: Metrics,
    /// Where all figures are.
    pub registry: Registry,
    /// The names that the gateway may be called by, besides its addresses and `localhost`. Without ports.
    pub allowed_hosts: Vec<String>,
}

#[cfg(test)]
impl Context {
    /// Of these grippers, with a journal in memory.
    pub(crate) fn of(grippers: impl IntoIterator<Item = crate::gripper::Handle>) -> Self {
        let (journal, _) = Journal::open(crate::journal::Place::Memory, crate::journal::Retention::default()).unwrap();
        let (gateway, fleet) = ("wsg".parse().unwrap(), Grippers::new(grippers));
        let refusals = Arc::new(Refusals::new(journal.clone()));
        let network = Arc::new(Network::new("wsg".parse().unwrap(), fleet.clone()));
        let updates = Arc::new(Updates::new(&fleet, journal.clone(), network.clone()));
        let registry = Registry::new();
        let [metrics, ws_metrics] = ["http", "ws"].map(|door| Metrics::register(&registry, door).unwrap());
        let (closing, allowed_hosts) = (CancellationToken::new(), Vec::new());
        let runtimes = Runtimes::current();
        Self {
            gateway,
            fleet,
            journal,
            refusals,
            network,
            updates,
            closing,
            runtimes,
            metrics,
            ws_metrics,
            registry,
            allowed_hosts,
        }
    }
}

/// The whole of the HTTP door.
pub fn router(context: &Arc<Context>) -> Router {
    operations()
        .layer(Extension(methods(context)))
        .layer(middleware::from_fn_with_state(context.clone(), guard::refuse_foreigners))
        .layer(middleware::from_fn_with_state(context.clone(), refused::record))
        .layer(middleware::map_response(guard::harden))
        .layer(middleware::from_fn_with_state(context.clone(), watched::watch))
        .with_state(context.clone())
}

/// The same operations for the doors that have no paths, and their own guards.
pub(super) fn methods(context: &Arc<Context>) -> Methods {
    let recorded = middleware::from_fn_with_state(context.clone(), refused::record);
    Methods::new(operations().layer(recorded).with_state(context.clone()))
}

fn operations() -> Router<Arc<Context>> {
    let (routes, document) = routes().split_for_parts();
    routes.layer(Extension(Arc::new(docs::Documents::new(document)))).layer(CatchPanicLayer::custom(panicked))
}

/// The document of what [`router`] serves.
#[must_use]
pub fn openapi() -> OpenApi {
    routes().into_openapi()
}

type Routes = OpenApiRouter<Arc<Context>>;

fn routes() -> Routes {
    let (router, mut document) = OpenApiRouter::with_openapi(docs::base())
        .nest(API, api())
        .routes(routes!(gateway::health))
        .routes(routes!(gateway::readiness))
        .routes(routes!(gateway::metrics))
        .fallback(not_found)
        .split_for_parts();
    document.merge(forwarded::Forwarded::openapi());
    docs::without_null_bodies(&mut document);
    let router = router
        .merge(docs::page())
        .merge(dashboard::page())
        .method_not_allowed_fallback(method_not_allowed)
        .layer(middleware::from_fn(body::read_first));
    let mut all = OpenApiRouter::from(router);
    *all.get_openapi_mut() = document;
    all
}

fn journal() -> Routes {
    OpenApiRouter::new()
        .routes(routes!(journal::events))
        .routes(routes!(journal::grips))
        .routes(routes!(journal::grip))
        .routes(routes!(journal::curve))
        .layer(middleware::from_fn_with_state(Arc::new(Semaphore::new(large::MAX_READS)), large::count))
}

fn api() -> Routes {
    OpenApiRouter::new()
        .merge(journal())
        .routes(routes!(docs::openapi))
        .routes(routes!(asyncapi::asyncapi))
        .routes(routes!(grippers::list))
        .routes(routes!(grippers::info))
        .routes(routes!(grippers::state))
        .routes(routes!(motions::home))
        .routes(routes!(motions::move_fingers))
        .routes(routes!(motions::grip))
        .routes(routes!(motions::release))
        .routes(routes!(motions::stop))
        .routes(routes!(fast_stop::acknowledge))
        .routes(routes!(commands::get))
        .routes(routes!(commands::cancel))
        .routes(routes!(settings::get_acceleration, settings::set_acceleration))
        .routes(routes!(settings::get_force_limit, settings::set_force_limit))
        .routes(routes!(settings::get_soft_limits, settings::set_soft_limits, settings::clear_soft_limits))
        .routes(routes!(settings::get_overdrive, settings::set_overdrive))
        .routes(routes!(settings::get_tag, settings::set_tag))
        .routes(routes!(device::statistics))
        .routes(routes!(device::reset_statistics))
        .routes(routes!(fingers::one))
        .routes(routes!(fingers::data))
        .routes(routes!(fingers::power))
        .routes(routes!(device::tare))
        .routes(routes!(device::loop_back))
        .routes(routes!(raw::raw))
        .routes(routes!(lease::get, lease::take, lease::renew, lease::release))
        .routes(routes!(lease::hand_over))
        .routes(routes!(stream::stream))
        .routes(routes!(ws::open))
        .routes(routes!(fleet::list))
        .routes(routes!(fast_stop::one))
        .routes(routes!(fast_stop::all))
        .routes(routes!(fleet::fast_stop))
        // A FAST STOP with a trailing slash is accepted.
        .route("/grippers/{gripper}/fast-stop/", post(fast_stop::one))
        .route("/fast-stop/", post(fast_stop::all))
        .route("/fleet/fast-stop/", post(fleet::fast_stop))
        .route(fleet::FORWARDED[0], get(fleet::forward))
        .route(fleet::FORWARDED[1], get(fleet::forward).post(fleet::forward).put(fleet::forward).delete(fleet::forward))
}

async fn not_found() -> Problem {
    Problem::not_found("such path")
}

async fn method_not_allowed(method: Verb) -> Problem {
    Problem::new(Code::MethodNotAllowed, format!("{method} is not among the methods of this path, which Allow lists"))
}

/// A panic is a mistake of ours, and ends one request, not the gateway.
fn panicked(_: Box<dyn Any + Send>) -> Response {
    tracing::error!("a request handler panicked");
    Problem::new(Code::Internal, "the gateway made a mistake: its log says more").into_response()
}

#[cfg(test)]
mod tests;
