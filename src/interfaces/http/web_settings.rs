//! Settings of HTTP, WebSocket and the dashboard.

use std::time::Duration;

use url::{Position, Url};

use crate::fleet::{MAX_URL_BYTES, parse_dashboard};
use crate::settings::{SettingValue, between, flag, list, parsed, settings, whole};
use crate::transport::host::{InvalidWebUrl, check_host, parse_web_url};

settings! {
    /// Settings of HTTP, WebSocket and the dashboard.
    pub struct WebSettings {
        /// Host names of this machine that browsers and programs use.
        pub hosts: Vec<String> = "hosts", list("host names", "[\"cell-7.example\"]", host), Reload;
        /// Origins of foreign pages that can use the API: see
        /// [pages of other origins](access.md#pages-of-other-origins).
        pub cors_origins: Vec<String> = "cors_origins", list("origins", "[\"https://hmi.example\"]", origin), Reload;
        /// Origins of pages that can show the dashboard in a frame.
        pub frame_ancestors: Vec<String> = "frame_ancestors", list("origins", "[\"https://hmi.example\"]", origin), Reload;
        /// Time in seconds after which an HTTP connection without a request is closed.
        pub idle_timeout: Duration = "idle_timeout_s",
            whole(10, between(1..=3600, "choose how long an unused connection stays open"), Duration::from_secs), Reload;
        /// URL of this dashboard for browsers on other machines.
        pub public_url: Option<Url> = "public_url", public_url(), Restart;
        /// Announces the gateway on the local network by mDNS: see [finding gateways](operation.md#finding-gateways).
        pub mdns: bool = "mdns", flag(false), Reload;
    }
}

fn host(text: &str) -> Result<String, String> {
    check_host(text).map(|()| text.to_owned()).map_err(|error| format!("has {error}"))
}

fn origin(text: &str) -> Result<String, String> {
    let origin = text.parse::<Url>().ok().map(|url| url.origin().ascii_serialization());
    let origin = origin.filter(|origin| origin.starts_with("http") && origin == text);
    origin.ok_or_else(|| format!("has {text:?}: write an origin such as https://hmi.example"))
}

fn public_url() -> SettingValue<Option<Url>> {
    parsed(None, "", "an `http` or `https` URL", |text: String| parse_public_url(&text).map(Some))
        .shown("none", "\"https://cell-7.example:8080/\"")
}

fn parse_public_url(text: &str) -> Result<Url, String> {
    if let Err(InvalidWebUrl::Host(host)) = parse_web_url(text) {
        return Err(format!("has the host {host}"));
    }
    parse_dashboard(text).filter(is_plain).ok_or_else(|| {
        // The text can contain a password.
        format!(
            "is not a URL that others can open: write at most {MAX_URL_BYTES} bytes without user, password, query \
             and asterisk, such as https://cell-7.example:8080/"
        )
    })
}

fn is_plain(url: &Url) -> bool {
    *url.authority() == url[Position::BeforeHost..Position::AfterPort]
        && url.query().is_none()
        && url.fragment().is_none()
        // The URL becomes a part of a Zenoh key, where an asterisk is a wildcard.
        && !url.as_str().contains('*')
}
