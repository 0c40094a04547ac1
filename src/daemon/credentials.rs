//! Watches the credentials that expire, and renews the certificate that the gateway made itself.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use prometheus::core::{Collector, Desc};
use prometheus::proto::MetricFamily;
use prometheus::{IntGaugeVec, Opts, Registry};
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::task::spawn_blocking;
use tokio::time::{Instant, MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use crate::access::{Access, CredentialKind, ExpiringCredential};
use crate::gripper::Now;
use crate::gripper::recorder::Recorder as _;
use crate::interfaces::http::SharedSettings;
use crate::journal::Journal;

/// Interval at which the credentials are read, so that a new one is soon known.
const READ_EVERY: Duration = Duration::from_secs(1);

/// Time after the start in which the journal judges the clock. A certificate that was renewed by a wrong clock would lock
/// out clients that trust exactly the old one.
const CLOCK_JUDGED_WITHIN: Duration = Duration::from_secs(5);

/// Pause after a certificate could not be renewed.
const RENEWAL_RETRIED_AFTER: Duration = Duration::from_hours(1);

/// The credentials that expire, as last read.
pub(super) type Expiring = watch::Receiver<Vec<ExpiringCredential>>;

struct CredentialWatch {
    access: Arc<Access>,
    settings: SharedSettings,
    journal: Journal,
    /// Time before which no renewal is tried.
    renew_at: Instant,
}

/// Starts to watch the credentials until the gateway closes, and registers their metrics.
pub(super) fn watch_credentials(
    access: &Arc<Access>,
    settings: &SharedSettings,
    journal: &Journal,
    runtime: &Handle,
    registry: &Registry,
    closing: &CancellationToken,
) -> prometheus::Result<Expiring> {
    let (sender, receiver) = watch::channel(Vec::new());
    register(registry, receiver.clone())?;
    let watch = CredentialWatch {
        access: access.clone(),
        settings: settings.clone(),
        journal: journal.clone(),
        renew_at: Instant::now() + CLOCK_JUDGED_WITHIN,
    };
    runtime.spawn(closing.clone().run_until_cancelled_owned(watch.run(sender)));
    Ok(receiver)
}

impl CredentialWatch {
    async fn run(mut self, sender: watch::Sender<Vec<ExpiringCredential>>) {
        let mut ticks = interval(READ_EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            ticks.tick().await;
            // Files are read and written. After a panic, which is logged, nothing is watched any more.
            let Ok((watch, expiring)) = spawn_blocking(move || self.read()).await else { return };
            self = watch;
            sender.send_if_modified(|known| {
                let is_other = *known != expiring;
                *known = expiring;
                is_other
            });
        }
    }

    fn read(mut self) -> (Self, Vec<ExpiringCredential>) {
        let mut expiring = self.access.expiring();
        if let Some(tls) = &self.settings.get().tls {
            if Instant::now() >= self.renew_at && self.journal.health().borrow().clock.is_none() {
                match tls.renew(Now::read().wall) {
                    Ok(false) => {}
                    Ok(true) => {
                        tracing::info!(certificate = %tls.files().certificate.display(), "self-signed certificate renewed");
                    }
                    Err(error) => {
                        tracing::error!(%error, "self-signed certificate not renewed: retrying every hour");
                        self.renew_at = Instant::now() + RENEWAL_RETRIED_AFTER;
                    }
                }
            }
            expiring.extend(tls.expiry());
        }
        (self, expiring)
    }
}

/// Registers the metrics of the times at which credentials expire.
fn register(registry: &Registry, expiring: Expiring) -> prometheus::Result<()> {
    let token = Opts::new("wsg_token_expiry_timestamp_seconds", "Unix time at which the token expires.");
    let certificate =
        Opts::new("wsg_certificate_expiry_timestamp_seconds", "Unix time at which the TLS certificate expires.");
    registry.register(Box::new(ExpiryCollector {
        expiring,
        tokens: IntGaugeVec::new(token, &["token"])?,
        certificate: IntGaugeVec::new(certificate, &[])?,
        turn: Mutex::default(),
    }))
}

/// Times at which credentials expire, read at each scrape. Credentials without an end have none.
struct ExpiryCollector {
    expiring: Expiring,
    tokens: IntGaugeVec,
    certificate: IntGaugeVec,
    /// Turn of a scrape: another one must not reset its values.
    turn: Mutex<()>,
}

impl Collector for ExpiryCollector {
    fn desc(&self) -> Vec<&Desc> {
        [self.tokens.desc(), self.certificate.desc()].concat()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        self.tokens.reset();
        self.certificate.reset();
        for credential in self.expiring.borrow().iter() {
            let gauge = match credential.kind {
                CredentialKind::Token => self.tokens.with_label_values(&[&*credential.name]),
                CredentialKind::Certificate | CredentialKind::RenewedCertificate => {
                    self.certificate.with_label_values::<&str>(&[])
                }
            };
            gauge.set(credential.expires_at.as_second());
        }
        [self.tokens.collect(), self.certificate.collect()].concat()
    }
}
