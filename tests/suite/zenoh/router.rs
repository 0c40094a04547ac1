//! A Zenoh router that can be killed and restarted.

use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::json;

use super::commands::readiness;
use super::fleet::gateway;
use crate::harness::child::{Child, Signal};
use crate::harness::{eventually, port_for_later, zenoh::config};

/// Environment variable that turns [`router_process`] into a router.
const ROUTER_AT: &str = "WSG_TEST_ZENOH_ROUTER_AT";

/// A Zenoh router in its own process: what `zenohd` runs, without its plug-ins.
pub struct Router {
    child: Child,
    endpoint: String,
}

impl Router {
    /// Starts a router on a free port.
    pub fn start() -> Self {
        Self::at(format!("tcp/127.0.0.1:{}", port_for_later()))
    }

    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Starts a router at this endpoint.
    pub fn at(endpoint: String) -> Self {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "zenoh::router::router_process"]).env(ROUTER_AT, &endpoint);
        let (child, ..) = Child::start(command.stdout(Stdio::null()));
        Self { child, endpoint }
    }

    /// Suspends the process until [`Router::thaw`].
    pub fn freeze(&self) {
        self.child.signal(Signal::STOP);
    }

    pub fn thaw(&self) {
        self.child.signal(Signal::CONT);
    }

    /// Kills the router without notice, and returns its endpoint.
    pub async fn kill(mut self) -> String {
        self.child.kill();
        self.child.ended().await;
        self.endpoint
    }
}

/// Body of a [`Router`] process; does nothing without the variable.
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
async fn readiness_reports_a_router_outage_until_it_ends() {
    let router = Router::start();
    let gateway = gateway("cell", router.endpoint(), 1, &[]).await;
    let until_ready = async || {
        eventually("the gateway is ready", async || {
            (readiness(&gateway).await == (json!(true), String::new(), 1.0)).then_some(())
        })
        .await;
    };
    until_ready().await;
    // `other` connects to this gateway, which affects only its own readiness.
    let other = super::fleet::gateway("other", &gateway.word_after("Zenoh: ").await, 1, &[]).await;
    eventually("the other gateway is ready", async || (readiness(&other).await.0 == true).then_some(())).await;
    let endpoint = router.kill().await;
    let not_ready = eventually("the missing router is reported", async || {
        let (ready, cause, up) = readiness(&gateway).await;
        (ready == false && up == 0.0).then_some(cause)
    });
    let cause = not_ready.await;
    assert!(cause.contains(&format!("not connected to {endpoint}")) && cause.contains("--zenoh-connect"), "{cause}");
    assert_eq!(readiness(&other).await.1, "");
    let _router = Router::at(endpoint);
    until_ready().await;
}
