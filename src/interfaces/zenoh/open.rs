//! Opening of a Zenoh session.

use std::time::Duration;

use tokio::sync::oneshot;
use zenoh::Wait as _;

use super::connectivity::{Connectivity, report_connection};
use crate::fleet::Peers;

/// First and longest pause before Zenoh is opened again after a failure.
const OPENED_AGAIN_AFTER: Duration = Duration::from_millis(250);
const OPENED_AGAIN_AT_LEAST_EVERY: Duration = Duration::from_secs(30);

#[derive(Debug)]
pub struct OpenSession {
    pub session: zenoh::Session,
    /// Whether the session was opened only because it listens on all endpoints. If false, some may be missing.
    pub listens_everywhere: bool,
}

impl OpenSession {
    /// Opens a session, retrying until it succeeds.
    pub async fn open(connectivity: &Connectivity, network: &Peers) -> Self {
        let mut again_after = OPENED_AGAIN_AFTER;
        loop {
            match Self::try_open(connectivity).await {
                Ok(open) => return open,
                Err(error) => report_connection(network, Some(format!("Zenoh could not be opened: {error}"))),
            }
            tokio::time::sleep(again_after).await;
            again_after = (again_after * 2).min(OPENED_AGAIN_AT_LEAST_EVERY);
        }
    }

    /// First tries a session that opens only if it listens on all endpoints. If that fails, opens one that retries
    /// them in the background. There, Zenoh 1.10 can lose an open listener from its list of locators, because two tasks
    /// that finish at the same time overwrite each other's list.
    async fn try_open(connectivity: &Connectivity) -> zenoh::Result<Self> {
        if let Some(config) = connectivity.without_retries()
            && let Ok(session) = open(config).await
        {
            return Ok(Self { session, listens_everywhere: true });
        }
        Ok(Self { session: open(connectivity.config.clone()).await?, listens_everywhere: false })
    }
}

/// Opens a session on its own thread. Zenoh can block forever while it waits for a router, so shutdown does not wait
/// for this thread.
async fn open(config: zenoh::Config) -> zenoh::Result<zenoh::Session> {
    let (send, opened) = oneshot::channel();
    std::thread::Builder::new().name("zenoh-open".to_owned()).spawn(move || {
        // The receiver may be gone by now.
        let _ = send.send(zenoh::open(config).wait());
    })?;
    opened.await?
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use serde_json::json;
    use tokio::net::TcpStream;
    use tokio::time::{sleep, timeout};

    use super::*;

    const LOOKS_EVERY: Duration = Duration::from_millis(10);
    const DEADLINE: Duration = Duration::from_secs(10);

    /// A configuration that retries endpoints in the background, like the gateway's.
    fn connectivity(listen: &[&str], connect: &[&str]) -> Connectivity {
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("listen/endpoints", json!(listen)),
            ("listen/exit_on_failure", json!(false)),
            ("listen/timeout_ms", json!(-1)),
            ("listen/retry", json!({"period_init_ms": 10, "period_max_ms": 10})),
            ("connect/endpoints", json!(connect)),
            ("connect/exit_on_failure", json!(false)),
            ("connect/timeout_ms", json!(-1)),
            ("scouting/multicast/enabled", json!(false)),
        ] {
            config.insert_json5(key, &value.to_string()).unwrap();
        }
        let owned = |endpoints: &[&str]| endpoints.iter().map(|&endpoint| endpoint.to_owned()).collect();
        Connectivity { config, listen: owned(listen), connect: owned(connect) }
    }

    fn endpoint(listener: &TcpListener) -> String {
        format!("tcp/{}", listener.local_addr().unwrap())
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn opened_session_listens_at_once() {
        let connectivity = connectivity(&["tcp/127.0.0.1:0"; 20], &[]);
        for _ in 0..10 {
            let OpenSession { session, listens_everywhere } = OpenSession::try_open(&connectivity).await.unwrap();
            assert!(listens_everywhere);
            assert_eq!(session.info().locators().await.len(), 20);
            session.close().await.unwrap();
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn free_endpoint_is_open_while_a_taken_one_is_retried() {
        // `silent` accepts connections but never answers, so that closing a session takes 10 s.
        let [taken, free, silent] = std::array::from_fn(|_| TcpListener::bind("127.0.0.1:0").unwrap());
        let (first, second, connect) = (endpoint(&free), endpoint(&taken), endpoint(&silent));
        let address = free.local_addr().unwrap();
        drop(free);
        let connectivity = connectivity(&[&first, &second], &[&connect]);
        let OpenSession { session, listens_everywhere } = OpenSession::try_open(&connectivity).await.unwrap();
        assert!(!listens_everywhere);
        let is_served = async {
            while TcpStream::connect(address).await.is_err() {
                sleep(LOOKS_EVERY).await;
            }
        };
        timeout(DEADLINE, is_served).await.unwrap();
        drop(taken);
        let is_complete = async {
            let listed = async || session.info().locators().await.iter().map(ToString::to_string).collect::<Vec<_>>();
            while !listed().await.contains(&second) {
                sleep(LOOKS_EVERY).await;
            }
            assert!(listed().await.contains(&first));
        };
        timeout(DEADLINE, is_complete).await.unwrap();
        // Otherwise closing the session waits 10 s for this peer.
        drop(silent);
    }
}
