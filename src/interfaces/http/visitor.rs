//! The client behind a request, and what it presents.

use axum::http::header::{AUTHORIZATION, COOKIE, HeaderValue, ORIGIN};
use axum::http::{Extensions, HeaderMap};

use super::settings::HttpSettings;
use crate::access::{Access, ClientOrigin, Credential, Identity, SessionId, Unauthorized, Visitor};
use crate::gripper::model::{Client, Door, Name};

/// Name of the cookie with a session's id.
pub const SESSION_COOKIE: &str = "wsg_session";

/// Name of that cookie over TLS. Browsers accept such a name only from this very host (RFC 6265bis, 4.1.3.2).
const SECURE_COOKIE: &str = "__Host-wsg_session";

/// Returns the name of the session's cookie. With TLS, a cookie that was set without it does not count.
pub fn cookie_name(has_tls: bool) -> &'static str {
    if has_tls { SECURE_COOKIE } else { SESSION_COOKIE }
}

/// Returns the name of the session's cookie. Returns `None` for a page of another origin, which has no session here.
pub fn accepted_cookie(headers: &HeaderMap, settings: &HttpSettings) -> Option<&'static str> {
    let is_foreign = headers.get_all(ORIGIN).iter().any(|origin| settings.allows_origin(origin));
    (!is_foreign).then(|| cookie_name(settings.tls.is_some()))
}

/// The client behind a request, identified when the request arrived.
#[derive(Debug, Clone)]
pub struct Identified {
    pub visitor: Visitor,
    pub identity: Result<Identity, Unauthorized>,
}

impl Identified {
    pub fn of(access: &Access, headers: &HeaderMap, origin: ClientOrigin, cookie: Option<&str>) -> Self {
        let visitor = Visitor { credential: credential(headers, cookie), origin };
        let identity = visitor.identity(access);
        Self { visitor, identity }
    }

    /// Returns the client of a request. A request without a connection, as in tests, counts as sent without a
    /// credential.
    pub fn client_of(access: &Access, extensions: &Extensions) -> Self {
        extensions.get().cloned().unwrap_or_else(|| {
            let visitor = Visitor { credential: Credential::None, origin: ClientOrigin::default() };
            let identity = visitor.identity(access);
            Self { visitor, identity }
        })
    }

    /// The client as it appears in the journal: its name, or else its address.
    pub fn client(&self, door: Door) -> Client {
        let name = self.identity.as_ref().ok().and_then(|identity| identity.name.as_ref());
        let by_address = || {
            let door = if door == Door::Ws { "ws" } else { "http" };
            self.visitor.origin.address.map_or_else(|| format!("{door}:unknown"), |peer| format!("{door}:{peer}"))
        };
        let subject = name.map_or_else(by_address, Name::to_string);
        Client::new(subject, door)
    }
}

/// Returns the client of a request as it appears in the journal.
pub fn client(extensions: &Extensions) -> Client {
    let of_nobody = || Client::new("http:unknown", Door::Http);
    extensions.get::<Identified>().map_or_else(of_nobody, |identified| identified.client(Door::Http))
}

/// Returns what a request presents. A token precedes a session, since only programs send tokens.
fn credential(headers: &HeaderMap, cookie: Option<&str>) -> Credential {
    let mut tokens = headers.get_all(AUTHORIZATION).iter();
    match (tokens.next(), tokens.next()) {
        (None, _) => cookie.and_then(|cookie| session(headers, cookie)).map_or(Credential::None, Credential::Session),
        (Some(token), None) => bearer(token),
        (Some(_), Some(_)) => Credential::Malformed,
    }
}

/// Parses `Bearer TOKEN` (RFC 6750, 2.1).
fn bearer(value: &HeaderValue) -> Credential {
    match value.to_str().ok().and_then(|value| value.split_once(' ')) {
        Some((scheme, token)) if scheme.eq_ignore_ascii_case("Bearer") => Credential::of_token(token.trim()),
        _ => Credential::Malformed,
    }
}

/// Returns the session in a request's cookie of this name.
pub fn session(headers: &HeaderMap, cookie: &str) -> Option<SessionId> {
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == cookie).and_then(|(_, id)| SessionId::parse(id))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: &'static str, values: &[&str]) -> HeaderMap {
        values.iter().map(|value| (name.parse().unwrap(), value.parse().unwrap())).collect()
    }

    #[test]
    fn client_is_known_by_its_address() {
        let peer: std::net::IpAddr = "::ffff:10.0.0.7".parse().unwrap();
        let identified = Identified::of(&Access::default(), &HeaderMap::new(), peer.into(), Some(SESSION_COOKIE));
        assert_eq!(&*identified.client(Door::Http).subject, "http:10.0.0.7");
    }

    #[test]
    fn token_comes_in_one_bearer_header() {
        let token = crate::access::TokenSecret::generate().unwrap();
        let [upper, lower] = ["Bearer", "bearer"].map(|scheme| format!("{scheme} {}", token.expose()));
        for value in [&upper, &lower] {
            assert_eq!(
                credential(&headers("authorization", &[value]), Some(SESSION_COOKIE)),
                Credential::Token(token.clone())
            );
        }
        for values in [&["Basic YTpi"][..], &["Bearer"], &[token.expose()], &[&upper, &upper]] {
            assert_eq!(
                credential(&headers("authorization", values), Some(SESSION_COOKIE)),
                Credential::Malformed,
                "{values:?}"
            );
        }
        assert_eq!(credential(&HeaderMap::new(), Some(SESSION_COOKIE)), Credential::None);
    }

    #[test]
    fn invalid_token_is_distinguished_from_another_scheme() {
        let refused = |value: &str| {
            let presented = headers("authorization", &[value]);
            let found =
                Identified::of(&Access::default(), &presented, ClientOrigin::default(), None).visitor.credential;
            format!("{found:?}")
        };
        assert_eq!(refused("Basic YTpi"), "Malformed");
        for value in ["Bearer x", "Bearer wsg_wrong", "bearer TOKEN"] {
            assert!(refused(value).starts_with("NotAToken"), "{value}");
        }
    }

    #[test]
    fn session_is_one_of_the_cookies() {
        let id = "x".repeat(43);
        let found = credential(&headers("cookie", &[&format!("a=b; wsg_session={id}"), "c=d"]), Some(SESSION_COOKIE));
        assert_eq!(found, Credential::Session(SessionId::parse(&id).unwrap()));
        let planted = credential(&headers("cookie", &[&format!("wsg_session={id}")]), Some(cookie_name(true)));
        assert_eq!(planted, Credential::None, "set without TLS");
        assert_eq!(
            credential(&headers("cookie", &["wsg_session=short", "xwsg_session=y"]), Some(SESSION_COOKIE)),
            Credential::None
        );
    }
}
