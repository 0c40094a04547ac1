//! Settings of HTTP that a reload can change.

use std::sync::{Arc, PoisonError, RwLock};

use axum::http::HeaderValue;

use super::WebSettings;
use crate::connections::tls::Tls;
use crate::interfaces::dashboard::DashboardPolicy;

/// Default port of the listener.
pub const DEFAULT_PORT: u16 = 8080;

#[derive(Debug, Clone)]
pub struct HttpSettings {
    /// TCP port of the listener.
    pub port: u16,
    pub web: WebSettings,
    /// Pages that can show the dashboard in a frame.
    pub frame_policy: DashboardPolicy,
    /// `None` if connections are not encrypted.
    pub tls: Option<Arc<Tls>>,
}

/// The current settings. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct SharedSettings(Arc<RwLock<Arc<HttpSettings>>>);

impl HttpSettings {
    /// Value of the `Keep-Alive` header.
    pub fn keep_alive(&self) -> HeaderValue {
        let text = format!("timeout={}", self.web.idle_timeout.as_secs());
        HeaderValue::try_from(text).unwrap_or(HeaderValue::from_static(""))
    }

    /// Whether pages of a foreign origin can use the API.
    pub fn allows_origin(&self, origin: &HeaderValue) -> bool {
        self.web.cors_origins.iter().any(|allowed| origin == allowed.as_str())
    }
}

impl Default for HttpSettings {
    fn default() -> Self {
        let web = WebSettings::default();
        Self { port: DEFAULT_PORT, web, frame_policy: DashboardPolicy::default(), tls: None }
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
