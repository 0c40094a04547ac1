//! Zenoh's router, which may die and come back.

use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::json;

use super::commands::readiness;
use super::fleet::gateway;
use crate::harness::process::signal;
use crate::harness::{eventually, zenoh::config};

/// The environment variable that makes the test below a router.
const ROUTER_AT: &str = "WSG_TEST_ZENOH_ROUTER_AT";

/// Zenoh's router, in a process of its own: what `zenohd` runs, without its plug-ins.
pub struct Router {
    child: Child,
    endpoint: String,
}

impl Router {
    /// On a free port.
    pub fn start() -> Self {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        Self::at(format!("tcp/127.0.0.1:{port}"))
    }

    /// Where it listens.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// There.
    pub fn at(endpoint: String) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "zenoh::router::router_process"]).env(ROUTER_AT, &endpoint);
        let child = command.stdout(Stdio::null()).spawn().unwrap();
        Self { child, endpoint }
    }

    /// Takes its processor time away until it is thawed.
    pub fn freeze(&self) {
        signal(self.child.id(), "STOP");
    }

    /// Gives it back.
    pub fn thaw(&self) {
        signal(self.child.id(), "CONT");
    }

    /// It dies, and says nothing.
    pub fn kill(mut self) -> String {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        std::mem::take(&mut self.endpoint)
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What a [`Router`] runs; without its variable it does nothing.
#[tokio::test(flavor = "multi_thread")]
async fn router_process() {
    let Ok(endpoint) = std::env::var(ROUTER_AT) else { return };
    let parent = std::os::unix::process::parent_id();
    let _session = zenoh::open(config("router", &[&endpoint], &[])).await.unwrap();
    while std::os::unix::process::parent_id() == parent {
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_that_is_away_is_told_for_as_long_as_it_is() {
    let router = Router::start();
    let gateway = gateway("cell", router.endpoint(), 1, &[]).await;
    let until_ready = async || {
        eventually("it is ready", async || {
            (readiness(&gateway).await == (json!(true), String::new(), 1.0)).then_some(())
        })
        .await;
    };
    until_ready().await;
    // Who connects to it is not what it is to connect to.
    let other = super::fleet::gateway("other", &gateway.word_after("Zenoh: ").await, 1, &[]).await;
    eventually("it is ready, too", async || (readiness(&other).await.0 == true).then_some(())).await;
    let endpoint = router.kill();
    let told = eventually("it is told", async || {
        let (ready, cause, up) = readiness(&gateway).await;
        (ready == false && up == 0.0).then_some(cause)
    });
    let cause = told.await;
    assert!(cause.contains(&format!("not connected to {endpoint}")) && cause.contains("--zenoh-connect"), "{cause}");
    assert_eq!(readiness(&other).await.1, "");
    let _router = Router::at(endpoint);
    until_ready().await;
}
