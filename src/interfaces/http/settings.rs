//! Settings of HTTP that a reload can change.

use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

use axum::http::HeaderValue;

use crate::interfaces::dashboard::DashboardPolicy;
use crate::interfaces::tls::Tls;

/// Default time after which an idle connection is closed.
const DEFAULT_IDLE_TIME: Duration = Duration::from_secs(10);

#[derive(Debug, Clone)]
pub struct HttpSettings {
    /// Host names that requests may use besides addresses and `localhost`, without ports.
    pub allowed_hosts: Vec<String>,
    /// Origins of foreign pages that can use the API.
    pub cors_origins: Vec<String>,
    /// Pages that can show the dashboard in a frame.
    pub frame_policy: DashboardPolicy,
    /// `None` if connections are not encrypted.
    pub tls: Option<Arc<Tls>>,
    /// Time that a connection can be idle between requests. It also bounds the time for a request's header to arrive.
    pub idle_time: Duration,
}

/// The current settings. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct SharedSettings(Arc<RwLock<Arc<HttpSettings>>>);

impl HttpSettings {
    /// Value of the `Keep-Alive` header.
    pub fn keep_alive(&self) -> HeaderValue {
        let text = format!("timeout={}", self.idle_time.as_secs());
        HeaderValue::try_from(text).unwrap_or(HeaderValue::from_static(""))
    }

    /// Whether pages of a foreign origin can use the API.
    pub fn allows_origin(&self, origin: &HeaderValue) -> bool {
        self.cors_origins.iter().any(|allowed| origin == allowed.as_str())
    }
}

impl Default for HttpSettings {
    fn default() -> Self {
        Self {
            allowed_hosts: Vec::new(),
            cors_origins: Vec::new(),
            frame_policy: DashboardPolicy::default(),
            tls: None,
            idle_time: DEFAULT_IDLE_TIME,
        }
    }
}

impl SharedSettings {
    #[must_use]
    pub fn new(settings: HttpSettings) -> Self {
        let shared = Self::default();
        shared.replace(settings);
        shared
    }

    #[must_use]
    pub fn get(&self) -> Arc<HttpSettings> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub fn replace(&self, settings: HttpSettings) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(settings);
    }
}
