//! The URL at which users of other gateways reach this dashboard.

use url::{Position, Url};

use super::{ConfigError, File};
use crate::fleet::{MAX_URL_BYTES, parse_dashboard};
use crate::transport::host::{InvalidWebUrl, parse_web_url};

pub(super) fn public_url(file: Option<&File>) -> Result<Option<Url>, ConfigError> {
    let Some((file, text)) = file.and_then(|file| Some((file, file.content.public_url.as_ref()?))) else {
        return Ok(None);
    };
    let is_plain = |url: &Url| {
        *url.authority() == url[Position::BeforeHost..Position::AfterPort]
            && url.query().is_none()
            && url.fragment().is_none()
            // The URL becomes a part of a Zenoh key, where an asterisk is a wildcard.
            && !url.as_str().contains('*')
    };
    if let Err(InvalidWebUrl::Host(host)) = parse_web_url(text.get_ref()) {
        return Err(ConfigError::at(&file.place(text.span().start), format!("public_url has the host {host}")));
    }
    let url = parse_dashboard(text.get_ref()).filter(is_plain);
    url.map(Some).ok_or_else(|| {
        // The text can contain a password.
        let detail = format!(
            "public_url is not a URL that others can open: write at most {MAX_URL_BYTES} bytes without user, password, \
             query and asterisk, such as https://cell-7.example:8080/"
        );
        ConfigError::at(&file.place(text.span().start), detail)
    })
}
