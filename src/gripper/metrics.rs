//! What is measured of a gripper, for Prometheus.
//!
//! The actor counts in a [`Metrics`]; what can be seen in the newest state is a gauge of [`Newest`], taken when it is
//! asked for, so that it costs the actor nothing.

use std::sync::Arc;

use prometheus::core::{Collector, Desc};
use prometheus::proto::MetricFamily;
use prometheus::{
    Gauge, Histogram, HistogramOpts, HistogramVec, IntCounter, IntCounterVec, IntGauge, Opts, Registry, Result,
};
use tokio::sync::watch;

use super::clock;
use super::handle::Handle;
use super::model::{Link, Name, State};

/// The series of one gripper, at most: all kinds with all outcomes, and all causes, have happened.
pub const MAX_SERIES: usize = 193;

/// Of answers and FAST STOPs, in seconds: from a socket in this machine to a slow line, and a link that was lost.
const LATENCIES: [f64; 11] = [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0];

/// Of motions, in seconds: from a few millimetres to the slowest homing.
const DURATIONS: [f64; 10] = [0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0];

/// What the actor counts. Nothing restarts with a link's session.
#[derive(Debug, Clone)]
pub struct Metrics {
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
}

impl Metrics {
    /// Of one gripper.
    ///
    /// # Errors
    /// Where the registry has one of this name already.
    pub fn register(registry: &Registry, gripper: &Name) -> Result<Self> {
        let of = Of { registry, gripper };
        let frames = of.counters("wsg_frames_total", "Frames to and from the device.", &["direction"])?;
        let bytes = of.counters("wsg_bytes_total", "Bytes to and from the device.", &["direction"])?;
        let discarded = of.counters(
            "wsg_discarded_replies_total",
            "Replies that answer nothing: late, of a request that was given up; stray, of one that was never made; \
             invalid, with contents that can't be.",
            &["reason"],
        )?;
        Ok(Self {
            reconnects: of.counter("wsg_reconnects_total", "Times that a link was made again after it was lost.")?,
            round_trip: of.histogram(
                "wsg_round_trip_seconds",
                "From a request's frame to the device's first answer to it.",
                &LATENCIES,
            )?,
            frames_sent: frames.with_label_values(&["sent"]),
            frames_received: frames.with_label_values(&["received"]),
            bytes_sent: bytes.with_label_values(&["sent"]),
            bytes_received: bytes.with_label_values(&["received"]),
            checksum_errors: of.counter("wsg_checksum_errors_total", "Frames rejected for their checksum.")?,
            resynchronisations: of
                .counter("wsg_resynchronisations_total", "Times that a frame was found after bytes that were none.")?,
            late_replies: discarded.with_label_values(&["late"]),
            stray_replies: discarded.with_label_values(&["stray"]),
            invalid_replies: discarded.with_label_values(&["invalid"]),
            timeouts: of.counter("wsg_timeouts_total", "Requests to the device that ended by a deadline.")?,
            updates: of.counter("wsg_updates_total", "Values of the device's state that were received.")?,
            commands: of.counters(
                "wsg_commands_total",
                "Commands that have ended, by kind and outcome. A grip's PART_HELD and NO_PART are among them.",
                &["kind", "outcome"],
            )?,
            motions: of.register(HistogramVec::new(
                of.histogram_opts(
                    "wsg_motion_duration_seconds",
                    "From a motion's admission to its end, by kind; without those that were refused.",
                    &DURATIONS,
                ),
                &["kind"],
            )?)?,
            fast_stops: of.counters("wsg_fast_stops_total", "FAST STOPs that were latched, by cause.", &["cause"])?,
            fast_stop_sent: of.histogram(
                "wsg_fast_stop_sent_seconds",
                "From the request of a FAST STOP to its first frame's way to the device: without a link, until there \
                 is one.",
                &LATENCIES,
            )?,
            fast_stop_confirmed: of.histogram(
                "wsg_fast_stop_confirmed_seconds",
                "From the request of a FAST STOP to the device's flags that show it.",
                &LATENCIES,
            )?,
            parts_lost: of.counter("wsg_parts_lost_total", "Times that a part was lost that had been held.")?,
        })
    }
}

/// The gauges of a gripper's newest state.
#[derive(Debug)]
pub struct Newest {
    state: watch::Receiver<Arc<State>>,
    link_up: IntGauge,
    latched: IntGauge,
    age: Gauge,
    temperature: Gauge,
}

impl Newest {
    /// Of one gripper, which it doesn't keep alive.
    ///
    /// # Errors
    /// Where the registry has one of this name already.
    pub fn register(registry: &Registry, handle: &Handle) -> Result<()> {
        let of = Of { registry, gripper: handle.name() };
        let newest = Self {
            state: handle.states(),
            link_up: IntGauge::with_opts(of.opts("wsg_link_up", "Whether the link is set up, and heard from."))?,
            latched: IntGauge::with_opts(of.opts("wsg_fast_stop_latched", "Whether a FAST STOP holds."))?,
            age: Gauge::with_opts(of.opts("wsg_update_age_seconds", "The age of the newest update."))?,
            temperature: Gauge::with_opts(of.opts("wsg_temperature_celsius", "The device's temperature."))?,
        };
        registry.register(Box::new(newest))
    }
}

impl Collector for Newest {
    fn desc(&self) -> Vec<&Desc> {
        // The registry tells collectors apart by the sum of their descriptions' hashes, and sums of several meet: one
        // description tells grippers apart.
        self.link_up.desc()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        let state = self.state.borrow().clone();
        // An actor that is gone has left its last state behind.
        let up = state.link == Link::Connected && self.state.has_changed().is_ok();
        self.link_up.set(up.into());
        self.latched.set(state.latch.is_some().into());
        let mut families = [self.link_up.collect(), self.latched.collect()].concat();
        if let Some(at) = state.updated_at {
            self.age.set(clock::instant().saturating_duration_since(at).as_secs_f64());
            families.extend(self.age.collect());
        }
        if let Some(temperature_c) = state.temperature_c {
            self.temperature.set(temperature_c.into());
            families.extend(self.temperature.collect());
        }
        families
    }
}

/// Makes what bears a gripper's name, and registers it.
struct Of<'a> {
    registry: &'a Registry,
    gripper: &'a Name,
}

impl Of<'_> {
    fn opts(&self, name: &str, help: &str) -> Opts {
        Opts::new(name, help).const_label("gripper", self.gripper.as_str())
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
        Ok(metric)
    }
}

#[cfg(test)]
mod tests {
    use strum::VariantArray as _;

    use super::super::fake::{self, Script};
    use super::super::model::{FastStopCause, Kind, Outcome};
    use super::*;

    #[tokio::test]
    async fn a_gripper_has_so_many_series_and_never_more() {
        let registry = Registry::new();
        let (handle, _seen) = fake::gripper("left", Script::default());
        let metrics = Metrics::register(&registry, handle.name()).unwrap();
        for kind in Kind::VARIANTS {
            for outcome in Outcome::VARIANTS {
                metrics.commands.with_label_values(&[kind.name(), outcome.name()]).inc();
            }
        }
        for kind in Kind::VARIANTS.iter().filter(|kind| kind.name() != "stop") {
            metrics.motions.with_label_values(&[kind.name()]).observe(1.0);
        }
        for cause in FastStopCause::VARIANTS {
            metrics.fast_stops.with_label_values(&[cause.name()]).inc();
        }
        Newest::register(&registry, &handle).unwrap();
        let text = prometheus::TextEncoder::new().encode_to_string(&registry.gather()).unwrap();
        let series = text.lines().filter(|line| !line.starts_with('#')).count();
        // A gripper that was never heard has neither an age nor a temperature.
        assert_eq!(series, MAX_SERIES - 2, "{text}");
    }

    #[tokio::test]
    async fn grippers_of_any_names_have_metrics() {
        let registry = Registry::new();
        for name in
            (0..500).flat_map(|index| [format!("gripper{index}"), format!("station-{index}"), format!("g{index}")])
        {
            let (handle, _seen) = fake::gripper(&name, Script::default());
            Newest::register(&registry, &handle).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
    }

    #[test]
    fn two_grippers_share_the_families_and_a_name_is_taken_once() {
        let registry = Registry::new();
        for name in ["left", "right"] {
            Metrics::register(&registry, &name.parse().unwrap()).unwrap();
        }
        assert!(Metrics::register(&registry, &"left".parse().unwrap()).is_err());
    }
}
