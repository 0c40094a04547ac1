//! Errors of addresses that the gateway cannot listen on.

use std::fmt::Display;
use std::io;

use crate::connections::sockets::remedy;

/// Adds to an error what could not be listened on, and the remedy.
pub(super) fn failed(what: impl Display, error: io::Error) -> anyhow::Error {
    let remedy = remedy(error.kind());
    anyhow::Error::new(error).context(format!("{what}: {remedy}"))
}

#[cfg(test)]
mod tests {
    use std::io::ErrorKind;

    use super::*;

    #[test]
    fn remedy_matches_the_error() {
        for (kind, remedy, wrong) in [
            (ErrorKind::AddrInUse, "stop the program that listens there", "privilege"),
            (ErrorKind::PermissionDenied, "CAP_NET_BIND_SERVICE", "stop the program"),
            (ErrorKind::AddrNotAvailable, "does not have that address", "stop the program"),
        ] {
            let error = format!("{:#}", failed("cannot listen on 127.0.0.1:80", kind.into()));
            assert!(error.starts_with("cannot listen on 127.0.0.1:80: ") && error.contains(remedy), "{error}");
            assert!(!error.contains(wrong) && error.ends_with(&io::Error::from(kind).to_string()), "{error}");
        }
    }
}
