//! The announcement on the local network.

use std::time::Duration;

use mdns_sd::{Receiver, ResolvedService, ServiceDaemon, ServiceEvent};
use serde_json::json;
use tokio::time::timeout;

use crate::harness::{Directory, Gateway};

const SERVICE: &str = "_wsg-gateway._tcp.local.";

const WITHIN: Duration = Duration::from_secs(15);

/// Reads events of gateways named `name` until this returns a value.
async fn until<T>(events: &Receiver<ServiceEvent>, mut wanted: impl FnMut(ServiceEvent) -> Option<T>) -> T {
    let found = async {
        loop {
            if let Some(found) = wanted(events.recv_async().await.unwrap()) {
                return found;
            }
        }
    };
    timeout(WITHIN, found).await.expect("an event of the local network")
}

async fn resolved(events: &Receiver<ServiceEvent>, name: &str) -> Box<ResolvedService> {
    let is_ours = |event| match event {
        ServiceEvent::ServiceResolved(service) if service.get_fullname().starts_with(name) => Some(service),
        _ => None,
    };
    until(events, is_ours).await
}

async fn removed(events: &Receiver<ServiceEvent>, name: &str) {
    let is_ours =
        |event| matches!(event, ServiceEvent::ServiceRemoved(_, gone) if gone.starts_with(name)).then_some(());
    until(events, is_ours).await;
}

#[tokio::test]
async fn gateway_is_announced_until_it_ends() {
    let name = format!("cell-{}", &uuid::Uuid::now_v7().simple().to_string()[20..]);
    let toml = |mdns: bool| format!("name = \"{name}\"\nmdns = {mdns}\n");
    let files = Directory::new();
    let file = files.write("gateway.toml", &toml(true));
    let browser = ServiceDaemon::new().unwrap();
    let events = browser.browse(SERVICE).unwrap();
    let gateway = Gateway::start(&["--config", &file]).await;
    let port = url::Url::parse(&gateway.url("/")).unwrap().port().unwrap();
    let service = resolved(&events, &name).await;
    assert_eq!(service.get_port(), port);
    assert_eq!(service.get_addresses_v4(), ["127.0.0.1".parse().unwrap()].into());
    assert_eq!(service.get_property_val_str("scheme"), Some("http"));
    assert_eq!(service.get_property_val_str("version"), Some(env!("CARGO_PKG_VERSION")));

    let reload = async |mdns| {
        std::fs::write(&file, toml(mdns)).unwrap();
        gateway.send(gateway.request("POST", "/api/v1/reload").json(&json!({}))).await.ok()
    };
    assert_eq!(reload(false).await["changes"], json!(["mdns: changed"]));
    removed(&events, &name).await;
    reload(true).await;
    assert_eq!(resolved(&events, &name).await.get_port(), port);
    assert!(gateway.terminate().await.status.success());
    removed(&events, &name).await;
}
