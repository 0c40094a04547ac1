//! The webhooks in the configuration file.

use std::path::PathBuf;

use toml::Spanned;

use super::{ConfigError, File, blank};
use crate::journal::EventKind;
use crate::model::{Name, without_byte_order_mark};
use crate::settings::{optional, required, settings};
use crate::webhooks::{Authorities, SigningSecret, WebhookSettings};

/// Maximum number of webhooks. Each one reads the journal.
const MAX_WEBHOOKS: usize = 16;

settings! {
    pub(super) struct WebhookContent {
        /// Name of the webhook. The gateway stores the webhook's position in the journal under this name.
        name: Spanned<String> = "name", required(blank(), "a name", "\"mes\""), Reload;
        /// URL that each event is sent to.
        url: Spanned<String> = "url",
            required(blank(), "`http://…` or `https://…`", "\"https://mes.example/hooks/wsg\""), Reload;
        /// Kinds of events that are delivered.
        kinds: Option<Spanned<Vec<EventKind>>> = "kinds", optional("[kinds of events](mes.md#event-kinds)", "")
            .shown("all", "[\"command\", \"fast_stop\"]"), Reload;
        /// Secret that signs the deliveries. Either this key or `secret_file` is required.
        secret: Option<Spanned<SigningSecret>> = "secret", optional(
            "`whsec_` and 24 to 64 bytes in base64", "\"whsec_cmVwbGFjZSB0aGlzIGJ5IHlvdXIgb3duIHNlY3JldA==\"",
        ), Reload;
        /// File that contains the secret. A relative path starts at the directory of the configuration file.
        pub(super) secret_file: Option<Spanned<PathBuf>> = "secret_file", optional("a path", "\"mes.secret\""), Reload;
        /// Certificates of the authorities that the receiver's certificate can come from, in PEM form.
        pub(super) ca_file: Option<Spanned<PathBuf>> = "ca_file",
            optional("a path", "").shown("public authorities", "\"plant-ca.pem\""), Reload;
    }
}

/// Validates the webhooks in the file.
pub(super) fn settings(file: &File) -> Result<Vec<WebhookSettings>, ConfigError> {
    let mut all: Vec<WebhookSettings> = Vec::new();
    for webhook in &file.content.webhooks {
        let place = file.place(webhook.name.span().start);
        let name: Name = webhook.name.get_ref().parse().map_err(|error| ConfigError::at(&place, error))?;
        if all.iter().any(|other| other.name == name) {
            let detail = format!("two webhooks are named {:?}: give each its own name", name.as_str());
            return Err(ConfigError::at(&place, detail));
        }
        if all.len() == MAX_WEBHOOKS {
            let detail = format!("there are more than {MAX_WEBHOOKS} webhooks: let one receiver forward events");
            return Err(ConfigError::at(&place, detail));
        }
        if let Some(kinds) = webhook.kinds.as_ref().filter(|kinds| kinds.get_ref().is_empty()) {
            let detail = "kinds is empty: list kinds of events, or leave it out for all";
            return Err(ConfigError::at(&file.place(kinds.span().start), detail));
        }
        let secret = match (&webhook.secret, &webhook.secret_file) {
            (Some(secret), None) => secret.get_ref().clone(),
            (None, Some(path)) => from_file(file, path, |text| String::from_utf8_lossy(text).parse::<SigningSecret>())?,
            _ => {
                let detail = format!("webhook {name} needs either secret or secret_file: give one of them");
                return Err(ConfigError::at(&place, detail));
            }
        };
        let authorities = webhook.ca_file.as_ref().map(|path| from_file(file, path, Authorities::from_pem));
        all.push(WebhookSettings {
            receiver: webhook
                .url
                .get_ref()
                .parse()
                .map_err(|error| ConfigError::at(&file.place(webhook.url.span().start), error))?,
            kinds: webhook.kinds.as_ref().map(|kinds| kinds.get_ref().clone()),
            secret,
            authorities: authorities.transpose()?.unwrap_or_default(),
            name,
        });
    }
    Ok(all)
}

/// Reads and parses a file that the configuration names.
pub(super) fn from_file<T, E: std::fmt::Display>(
    file: &File,
    path: &Spanned<PathBuf>,
    parse: impl FnOnce(&[u8]) -> Result<T, E>,
) -> Result<T, ConfigError> {
    let named = file.beside(path.get_ref());
    let place = file.place(path.span().start);
    let text = std::fs::read(&named);
    let text = text.map_err(|error| ConfigError::at(&place, format!("{}: {error}", named.display())))?;
    let parsed = parse(without_byte_order_mark(&text));
    parsed.map_err(|error| ConfigError::at(&place, format!("{}: {error}", named.display())))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::{Config, Flags};
    use super::*;

    const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";

    fn parsed(text: &str) -> Result<Vec<WebhookSettings>, ConfigError> {
        let file = File::parse(Path::new("gateway.toml"), text.to_owned())?;
        Config::merge(&Flags::default(), Some(&file)).map(|config| config.webhooks)
    }

    #[test]
    fn webhooks_are_read() {
        let directory = std::env::temp_dir().join(format!("wsg-webhooks-{}", std::process::id()));
        std::fs::create_dir_all(&directory).unwrap();
        let secret = directory.join("secret");
        std::fs::write(&secret, format!("\u{FEFF}{SECRET}\n")).unwrap();
        let text = format!(
            "[[webhooks]]\nname = \"mes\"\nurl = \"https://mes.example/hook\"\nkinds = [\"fast_stop\"]\n\
             secret = \"{SECRET}\"\n[[webhooks]]\nname = \"log\"\nurl = \"http://127.0.0.1:1\"\n\
             secret_file = \"{}\"\n",
            secret.display()
        );
        let [mes, log] = parsed(&text).unwrap().try_into().unwrap();
        assert_eq!((mes.name.as_str(), &mes.kinds), ("mes", &Some(vec![EventKind::FastStop])));
        assert_eq!((log.secret, log.kinds), (mes.secret, None));
        std::fs::remove_dir_all(directory).unwrap();
    }

    #[test]
    fn wrong_webhook_is_named_without_its_secret() {
        let with = |lines: &str| format!("[[webhooks]]\nname = \"mes\"\nurl = \"http://mes/s3cret\"\n{lines}\n");
        let twice = [with(&format!("secret = \"{SECRET}\"")), with(&format!("secret = \"{SECRET}\""))].concat();
        for (text, expected) in [
            (with(""), "gateway.toml:2: webhook mes needs either secret or secret_file"),
            (with("secret = \"s3cret\""), "gateway.toml:4: the webhook's secret is not whsec_"),
            (with("secret_file = \"no-such-file\""), "gateway.toml:4: no-such-file: "),
            (with(&format!("secret = \"{SECRET}\"\nkinds = []")), "gateway.toml:5: kinds is empty"),
            (with(&format!("secret = \"{SECRET}\"\nkinds = [\"nonsense\"]")), "gateway.toml:5: unknown variant"),
            (with(&format!("secret = \"{SECRET}\"\nca_file = \"Cargo.toml\"")), "gateway.toml:5: Cargo.toml: no cert"),
            (twice, "gateway.toml:6: two webhooks are named \"mes\""),
            ("[[webhooks]]\nname = \"mes\"\nurl = \"mes\"\nsecret = \"s3cret\"".to_owned(), "gateway.toml:4: "),
        ] {
            let error = parsed(&text).unwrap_err().to_string();
            assert!(error.starts_with(expected) && !error.contains("s3cret"), "{error}");
        }
    }
}
