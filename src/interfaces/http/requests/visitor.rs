//! The client behind a request, and what it presents.

use axum::http::header::{AUTHORIZATION, COOKIE, HeaderValue, ORIGIN};
use axum::http::{Extensions, HeaderMap};

use super::origin::is_listed_other;
use crate::access::{Access, ClientOrigin, Credential, Identity, SessionId, Unauthorized, Visitor};
use crate::interfaces::http::http_settings::HttpSettings;
use crate::model::{Client, Door};

/// Beginning of a name over TLS. Browsers accept such a cookie only from this very host (RFC 6265bis, 4.1.3.2).
const SECURE_PREFIX: &str = "__Host-";

/// Returns the name of the cookie with a session's id. With TLS, a cookie that was set without it does not count.
///
/// The name ends with the port, because a browser sends the cookies of a host to all its ports (RFC 6265, 8.5), so that
/// several gateways on one machine would replace each other's. The port is the one that the gateway listens on: unlike
/// the name or the public URL, no two gateways of a machine can share it, unless they run in containers.
pub fn cookie_name(settings: &HttpSettings) -> String {
    let prefix = if settings.tls.is_some() { SECURE_PREFIX } else { "" };
    format!("{prefix}wsg_session_{}", settings.port)
}

/// Returns the name of the session's cookie. Returns `None` for a request without cookies, and for a page of another
/// origin, which has no session here.
pub fn accepted_cookie(headers: &HeaderMap, settings: &HttpSettings) -> Option<String> {
    let is_foreign = headers.get_all(ORIGIN).iter().any(|origin| is_listed_other(headers, origin, settings));
    (headers.contains_key(COOKIE) && !is_foreign).then(|| cookie_name(settings))
}

/// The client behind a request, identified when the request arrived.
#[derive(Debug, Clone)]
pub struct Identified {
    pub visitor: Visitor,
    pub identity: Result<Identity, Unauthorized>,
}

impl Identified {
    pub fn of(access: &Access, headers: &HeaderMap, origin: ClientOrigin, cookie: Option<&str>) -> Self {
        Self::with(access, credential(headers, cookie), origin)
    }

    /// Identifies a client by this credential.
    pub fn with(access: &Access, credential: Credential, origin: ClientOrigin) -> Self {
        let visitor = Visitor { credential, origin };
        let identity = visitor.identity(access);
        Self { visitor, identity }
    }

    /// Returns the client of a request. A request without a connection, as in tests, counts as sent without a
    /// credential.
    pub fn client_of(access: &Access, extensions: &Extensions) -> Self {
        let known = extensions.get().cloned();
        known.unwrap_or_else(|| Self::with(access, Credential::None, ClientOrigin::default()))
    }

    /// The client as it appears in the journal: its name, or else its address.
    pub fn client(&self, door: Door) -> Client {
        let name = self.identity.as_ref().ok().and_then(|identity| identity.name.as_ref());
        let subject = match name {
            Some(name) => name.to_string(),
            None => self.subject_by_address(door),
        };
        Client::new(subject, door)
    }

    fn subject_by_address(&self, door: Door) -> String {
        let interface = if door == Door::Ws { "ws" } else { "http" };
        match self.visitor.origin.address {
            Some(peer) => format!("{interface}:{peer}"),
            None => format!("{interface}:unknown"),
        }
    }
}

/// Returns the client of a request as it appears in the journal.
pub fn client(extensions: &Extensions) -> Client {
    match extensions.get::<Identified>() {
        Some(identified) => identified.client(Door::Http),
        None => Client::new("http:unknown", Door::Http),
    }
}

/// Returns what a request presents. A token precedes a session, since only programs send tokens.
fn credential(headers: &HeaderMap, cookie: Option<&str>) -> Credential {
    let mut tokens = headers.get_all(AUTHORIZATION).iter();
    let credential = match (tokens.next(), tokens.next()) {
        (None, _) => Credential::None,
        (Some(token), None) => bearer(token),
        (Some(_), Some(_)) => return Credential::Malformed,
    };
    match credential {
        // A proxy with a login of its own passes on the browser's `Basic` credentials, which are malformed here.
        Credential::None | Credential::Malformed => {
            cookie.and_then(|cookie| session(headers, cookie)).map_or(credential, Credential::Session)
        }
        token => token,
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
    use crate::interfaces::http::WebSettings;

    const SESSION_COOKIE: &str = "wsg_session_8080";

    fn headers(name: &'static str, values: &[&str]) -> HeaderMap {
        values.iter().map(|value| (name.parse().unwrap(), value.parse().unwrap())).collect()
    }

    #[test]
    fn gateways_own_page_keeps_its_session_although_it_is_listed() {
        let listed = ["http://cell.example:8080", "https://other.example"].map(str::to_owned);
        let web = WebSettings { cors_origins: listed.to_vec(), ..WebSettings::default() };
        let settings = HttpSettings { web, ..HttpSettings::default() };
        let accepted = |origin: &str| {
            let mut headers = headers("cookie", &["wsg_session_8080=x"]);
            headers.insert("host", "cell.example:8080".parse().unwrap());
            headers.insert("origin", origin.parse().unwrap());
            accepted_cookie(&headers, &settings)
        };
        assert!(accepted("http://cell.example:8080").is_some());
        assert_eq!(accepted("https://other.example"), None);
    }

    #[test]
    fn login_of_a_proxy_does_not_end_a_session() {
        let mut headers = headers("cookie", &[&format!("{SESSION_COOKIE}={}", "x".repeat(43))]);
        headers.insert("authorization", "Basic YW5uYTpzZWNyZXQ=".parse().unwrap());
        assert!(matches!(credential(&headers, Some(SESSION_COOKIE)), Credential::Session(_)));
        headers.insert("authorization", "Bearer nonsense".parse().unwrap());
        assert!(!matches!(credential(&headers, Some("another")), Credential::Session(_)));
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
    fn gateways_on_one_host_have_cookies_of_their_own() {
        let names = [8080, 8081].map(|port| cookie_name(&HttpSettings { port, ..HttpSettings::default() }));
        assert_eq!(names, ["wsg_session_8080", "wsg_session_8081"]);
        let any = headers("cookie", &["a=b"]);
        assert_eq!(accepted_cookie(&any, &HttpSettings::default()), Some(names[0].clone()));
    }

    #[test]
    fn session_is_one_of_the_cookies() {
        let id = "x".repeat(43);
        let found = credential(
            &headers("cookie", &[&format!("a=b; wsg_session_8081=z; wsg_session_8080={id}"), "c=d"]),
            Some(SESSION_COOKIE),
        );
        assert_eq!(found, Credential::Session(SessionId::parse(&id).unwrap()));
        let planted = headers("cookie", &[&format!("wsg_session_8080={id}")]);
        assert_eq!(credential(&planted, Some("__Host-wsg_session_8080")), Credential::None, "set without TLS");
        assert_eq!(
            credential(&headers("cookie", &["wsg_session_8080=short", "xwsg_session_8080=y"]), Some(SESSION_COOKIE)),
            Credential::None
        );
    }
}
