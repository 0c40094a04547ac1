//! Prometheus metrics of a gripper.
//!
//! The actor counts in [`GripperMetrics`]. Values of the newest state are gauges of [`Newest`], read when Prometheus
//! collects them, without work for the actor.

use std::cell::RefCell;
use std::fmt;
use std::sync::Arc;
use std::time::Instant;

use prometheus::core::{Collector, Desc};
use prometheus::proto::MetricFamily;
use prometheus::{
    Gauge, Histogram, HistogramOpts, HistogramVec, IntCounter, IntCounterVec, IntGauge, IntGaugeVec, Opts, Registry,
    Result,
};
use strum::VariantArray as _;
use tokio::sync::watch;

use super::handle::Handle;
use model::clock;
use model::{FastStopCause, Kind, Link, Name, Outcome, ServoEnd, State, Values};

/// Largest number of series for one gripper.
pub const MAX_SERIES: usize = 239;

/// Results of a servo session's target. One that a newer one replaces counts twice: as accepted, and as superseded.
pub(super) const SERVO_ACCEPTED: &str = "accepted";
pub(super) const SERVO_SUPERSEDED: &str = "superseded";
pub(super) const SERVO_REFUSED: &str = "refused";

/// Buckets for latencies of replies and FAST STOPs, in seconds: from a local socket to a slow line or a lost link.
const LATENCIES: [f64; 11] = [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0];

/// Buckets for durations of motions, in seconds: from a few millimetres to the slowest homing.
const DURATIONS: [f64; 10] = [0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0];

/// Counters and histograms of the actor. They continue across sessions of the link.
#[derive(Debug, Clone)]
pub struct GripperMetrics {
    pub(super) reconnects: IntCounter,
    pub(super) round_trip: Histogram,
    pub(super) frames_sent: IntCounter,
    pub(super) frames_received: IntCounter,
    pub(super) bytes_sent: IntCounter,
    pub(super) bytes_received: IntCounter,
    pub(super) checksum_errors: IntCounter,
    pub(super) resynchronisations: IntCounter,
    pub(super) late_replies: IntCounter,
    pub(super) stray_replies: IntCounter,
    pub(super) invalid_replies: IntCounter,
    pub(super) timeouts: IntCounter,
    pub(super) updates: IntCounter,
    pub(super) commands: IntCounterVec,
    pub(super) motions: HistogramVec,
    pub(super) fast_stops: IntCounterVec,
    pub(super) fast_stop_sent: Histogram,
    pub(super) fast_stop_confirmed: Histogram,
    pub(super) parts_lost: IntCounter,
    pub(super) servo_targets: IntCounterVec,
    pub(super) servo_sessions: IntCounterVec,
    _registration: Arc<Registration>,
}

/// Registered collectors, which are removed from the registry when this is dropped.
pub struct Registration {
    registry: Registry,
    collectors: Vec<Box<dyn Collector>>,
}

impl fmt::Debug for Registration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Registration").field("collectors", &self.collectors.len()).finish_non_exhaustive()
    }
}

impl Drop for Registration {
    fn drop(&mut self) {
        for collector in self.collectors.drain(..) {
            if let Err(error) = self.registry.unregister(collector) {
                tracing::error!(%error, "metric not removed");
            }
        }
    }
}

impl GripperMetrics {
    /// Registers the metrics of one gripper.
    ///
    /// # Errors
    /// If a gripper of this name is already registered.
    pub fn register(registry: &Registry, gripper: &Name) -> Result<Self> {
        let of = Of { registry, gripper, collectors: RefCell::default() };
        let frames = of.counters("wsg_frames_total", "Frames to and from the device.", &["direction"])?;
        let bytes = of.counters("wsg_bytes_total", "Bytes to and from the device.", &["direction"])?;
        let discarded = of.counters(
            "wsg_discarded_replies_total",
            "Discarded replies: late, after the request had timed out; stray, without a request; invalid, with contents \
             that the protocol does not allow.",
            &["reason"],
        )?;
        let commands = of.counters(
            "wsg_commands_total",
            "Ended commands, by kind and outcome. The outcomes include PART_HELD, NO_PART and WRONG_PART of grips.",
            &["kind", "outcome"],
        )?;
        let motions = of.register(HistogramVec::new(
            of.histogram_opts(
                "wsg_motion_duration_seconds",
                "Time from a motion's admission to its end, by kind, without refused motions.",
                &DURATIONS,
            ),
            &["kind"],
        )?)?;
        let fast_stops = of.counters("wsg_fast_stops_total", "Latched FAST STOPs, by cause.", &["cause"])?;
        let servo_targets =
            of.counters("wsg_servo_targets_total", "Targets of servo sessions, by result.", &["result"])?;
        for result in [SERVO_ACCEPTED, SERVO_SUPERSEDED, SERVO_REFUSED] {
            servo_targets.with_label_values(&[result]);
        }
        let servo_sessions =
            of.counters("wsg_servo_sessions_total", "Ended servo sessions, by the reason of their end.", &["reason"])?;
        for reason in ServoEnd::VARIANTS {
            servo_sessions.with_label_values(&[reason.name()]);
        }
        // Series start at 0: Prometheus would not count the first value of a new series as an increase.
        for kind in Kind::VARIANTS {
            for outcome in Outcome::VARIANTS {
                commands.with_label_values(&[kind.name(), outcome.name()]);
            }
            if *kind != Kind::Stop {
                motions.with_label_values(&[kind.name()]);
            }
        }
        for cause in FastStopCause::VARIANTS {
            fast_stops.with_label_values(&[cause.name()]);
        }
        Ok(Self {
            reconnects: of.counter("wsg_reconnects_total", "Reconnections after a lost link.")?,
            round_trip: of.histogram(
                "wsg_round_trip_seconds",
                "Time from a request's frame to the device's first reply.",
                &LATENCIES,
            )?,
            frames_sent: frames.with_label_values(&["sent"]),
            frames_received: frames.with_label_values(&["received"]),
            bytes_sent: bytes.with_label_values(&["sent"]),
            bytes_received: bytes.with_label_values(&["received"]),
            checksum_errors: of.counter("wsg_checksum_errors_total", "Frames rejected because of a wrong checksum.")?,
            resynchronisations: of.counter(
                "wsg_resynchronisations_total",
                "Number of times that a frame was found after skipped bytes.",
            )?,
            late_replies: discarded.with_label_values(&["late"]),
            stray_replies: discarded.with_label_values(&["stray"]),
            invalid_replies: discarded.with_label_values(&["invalid"]),
            timeouts: of.counter("wsg_timeouts_total", "Requests to the device that timed out.")?,
            updates: of.counter("wsg_updates_total", "State values received from the device.")?,
            commands,
            motions,
            fast_stops,
            fast_stop_sent: of.histogram(
                "wsg_fast_stop_sent_seconds",
                "Time from the request of a FAST STOP until its first frame is sent. Includes the time without a link.",
                &LATENCIES,
            )?,
            fast_stop_confirmed: of.histogram(
                "wsg_fast_stop_confirmed_seconds",
                "Time from the request of a FAST STOP until the device's flags show it.",
                &LATENCIES,
            )?,
            servo_targets,
            servo_sessions,
            parts_lost: of.counter("wsg_parts_lost_total", "Held parts that were lost.")?,
            _registration: Arc::new(of.registration()),
        })
    }
}

/// Returns one of the values, if it is known.
type ReportedValue = fn(&Values, Instant) -> Option<f64>;

/// Gauges of a gripper's newest state.
#[derive(Debug)]
pub struct Newest {
    state: watch::Receiver<Arc<State>>,
    link_up: IntGauge,
    latched: IntGauge,
    unconfirmed: IntGauge,
    leased: IntGauge,
    holder: IntGaugeVec,
    age: Gauge,
    /// Gauges that are missing in some states, each with a function that returns the value of a state.
    reported: [(Gauge, ReportedValue); 4],
}

impl Newest {
    /// Registers the gauges of one gripper until the returned value is dropped, without keeping the gripper alive.
    ///
    /// # Errors
    /// If a gripper of this name is already registered.
    pub fn register(registry: &Registry, handle: &Handle) -> Result<Registration> {
        let of = Of { registry, gripper: handle.name(), collectors: RefCell::default() };
        let newest = Self {
            state: handle.states(),
            link_up: of.flag("wsg_link_up", "1 if the link is set up and responds, else 0.")?,
            latched: of.flag("wsg_fast_stop_latched", "1 if a FAST STOP is latched, else 0.")?,
            unconfirmed: of.flag(
                "wsg_fast_stop_unconfirmed",
                "1 if a FAST STOP is latched that the device has not confirmed, else 0.",
            )?,
            leased: of.flag("wsg_lease_held", "1 if a client holds the lease, else 0.")?,
            holder: IntGaugeVec::new(
                of.opts("wsg_lease_holder_info", "Always 1; the label names the client that holds the lease."),
                &["holder"],
            )?,
            age: of.gauge("wsg_update_age_seconds", "Age of the oldest known value of the device.")?,
            reported: [
                (
                    of.gauge("wsg_temperature_celsius", "Temperature of the device; missing while unknown.")?,
                    |values, now| values.temperature_c(now).map(f64::from),
                ),
                (
                    of.gauge(
                        "wsg_state_code",
                        "Number of the gripper state, as in the manual; missing while unknown.",
                    )?,
                    |values, now| values.state_code(now).map(f64::from),
                ),
                (of.gauge("wsg_width_meters", "Opening width; missing while unknown.")?, |values, now| {
                    values.width_mm(now).map(|width_mm| f64::from(width_mm) / 1000.0)
                }),
                (
                    of.gauge("wsg_force_newtons", "Gripping force, summed over the fingers; missing while unknown.")?,
                    |values, now| values.force_n(now).map(f64::from),
                ),
            ],
        };
        // The registry knows it by this description.
        of.collectors.borrow_mut().push(Box::new(newest.link_up.clone()));
        registry.register(Box::new(newest))?;
        Ok(of.registration())
    }
}

impl Collector for Newest {
    fn desc(&self) -> Vec<&Desc> {
        // The registry identifies a collector by the sum of its descriptions' hashes, and sums of several can collide.
        // One description is enough to distinguish grippers.
        self.link_up.desc()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        let state = self.state.borrow().clone();
        // An actor that has ended leaves its last state behind.
        let up = state.link == Link::Connected && self.state.has_changed().is_ok();
        self.link_up.set(up.into());
        self.latched.set(state.latch.is_some().into());
        self.unconfirmed.set(state.latch.as_ref().is_some_and(|latch| !latch.fast_stop_confirmed).into());
        self.leased.set(state.lease_holder.is_some().into());
        let always = [&self.link_up, &self.latched, &self.unconfirmed, &self.leased];
        let mut families = always.map(Collector::collect).concat();
        if let Some(holder) = &state.lease_holder {
            self.holder.reset();
            self.holder.with_label_values(&[&**holder]).set(1);
            families.extend(self.holder.collect());
        }
        let now = clock::instant();
        if let Some(at) = state.values.oldest(now) {
            self.age.set(now.saturating_duration_since(at).as_secs_f64());
            families.extend(self.age.collect());
        }
        for (gauge, value) in &self.reported {
            if let Some(value) = value(&state.values, now) {
                gauge.set(value);
                families.extend(gauge.collect());
            }
        }
        families
    }
}

/// Creates and registers metrics with a gripper's name as their label.
struct Of<'a> {
    registry: &'a Registry,
    gripper: &'a Name,
    collectors: RefCell<Vec<Box<dyn Collector>>>,
}

impl Of<'_> {
    fn registration(&self) -> Registration {
        Registration { registry: self.registry.clone(), collectors: self.collectors.take() }
    }

    fn opts(&self, name: &str, help: &str) -> Opts {
        Opts::new(name, help).const_label("gripper", self.gripper.as_str())
    }

    /// Creates a gauge that is 1 or 0, without registering the gauge: [`Newest`] collects it.
    fn flag(&self, name: &str, help: &str) -> Result<IntGauge> {
        IntGauge::with_opts(self.opts(name, help))
    }

    /// Creates a gauge without registering it: [`Newest`] collects it.
    fn gauge(&self, name: &str, help: &str) -> Result<Gauge> {
        Gauge::with_opts(self.opts(name, help))
    }

    fn histogram_opts(&self, name: &str, help: &str, buckets: &[f64]) -> HistogramOpts {
        HistogramOpts { common_opts: self.opts(name, help), buckets: buckets.to_vec() }
    }

    fn counter(&self, name: &str, help: &str) -> Result<IntCounter> {
        self.register(IntCounter::with_opts(self.opts(name, help))?)
    }

    fn counters(&self, name: &str, help: &str, labels: &[&str]) -> Result<IntCounterVec> {
        self.register(IntCounterVec::new(self.opts(name, help), labels)?)
    }

    fn histogram(&self, name: &str, help: &str, buckets: &[f64]) -> Result<Histogram> {
        self.register(Histogram::with_opts(self.histogram_opts(name, help, buckets))?)
    }

    fn register<T: Collector + Clone + 'static>(&self, metric: T) -> Result<T> {
        self.registry.register(Box::new(metric.clone()))?;
        self.collectors.borrow_mut().push(Box::new(metric.clone()));
        Ok(metric)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fake::{self, FakeScript};
    use super::*;
    use model::{Client, Door, FastStopId, Reason};

    #[tokio::test]
    async fn series_of_a_gripper_are_bounded_and_start_at_zero() {
        let registry = Registry::new();
        let (handle, _seen) = fake::gripper("left", FakeScript::default());
        let metrics = GripperMetrics::register(&registry, handle.name()).unwrap();
        let newest = Newest::register(&registry, &handle).unwrap();
        let text = prometheus::TextEncoder::new().encode_to_string(&registry.gather()).unwrap();
        let series = text.lines().filter(|line| !line.starts_with('#')).count();
        // Without an update, the age, temperature, state, width and force are missing; without a lease, its holder.
        assert_eq!(series, MAX_SERIES - 6, "{text}");
        assert!(text.contains("wsg_fast_stops_total{cause=\"client_lost\",gripper=\"left\"} 0"), "{text}");
        drop((metrics, newest));
        assert_eq!(prometheus::TextEncoder::new().encode_to_string(&registry.gather()).unwrap(), "");
        GripperMetrics::register(&registry, handle.name()).unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn a_fast_stop_is_unconfirmed_until_the_device_shows_it() {
        for (confirms, expected) in [(false, 1), (true, 0)] {
            let registry = Registry::new();
            let (handle, _seen) = fake::gripper("left", FakeScript { confirms, ..FakeScript::default() });
            let _newest = Newest::register(&registry, &handle).unwrap();
            let client = Client::new("test", Door::Http);
            handle.fast_stop(FastStopId::generate(), client, Reason::truncated("")).await;
            let text = prometheus::TextEncoder::new().encode_to_string(&registry.gather()).unwrap();
            assert!(text.contains("wsg_fast_stop_latched{gripper=\"left\"} 1"), "{text}");
            assert!(text.contains(&format!("wsg_fast_stop_unconfirmed{{gripper=\"left\"}} {expected}")), "{text}");
        }
    }

    #[tokio::test]
    async fn grippers_of_any_names_have_metrics() {
        let (registry, mut all) = (Registry::new(), Vec::new());
        for name in
            (0..500).flat_map(|index| [format!("gripper{index}"), format!("station-{index}"), format!("g{index}")])
        {
            let (handle, _seen) = fake::gripper(&name, FakeScript::default());
            all.push(Newest::register(&registry, &handle).unwrap_or_else(|error| panic!("{name}: {error}")));
        }
    }

    #[test]
    fn grippers_share_families_and_a_name_registers_once() {
        let registry = Registry::new();
        let _both = ["left", "right"].map(|name| GripperMetrics::register(&registry, &name.parse().unwrap()).unwrap());
        assert!(GripperMetrics::register(&registry, &"left".parse().unwrap()).is_err());
    }
}
