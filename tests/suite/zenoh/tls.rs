//! The shipped network configuration: an observer's certificate permits reads and stops, but no motion.

use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use serde_json::{Value, json};
use wsg_gateway::access::Right;
use wsg_gateway::operations::all;

use crate::harness::{Directory, Gateway, MOTIONS, Proxy, Simulator, ZenohClient, eventually, zenoh::config};

const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/zenoh/gateway.json5");

/// A temporary directory with certificates from one authority.
struct Certificates {
    files: Directory,
    authority: Issuer<'static, KeyPair>,
}

impl Certificates {
    fn new() -> Self {
        let (mut params, key) = (named("cell CA"), KeyPair::generate().unwrap());
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let certificate = params.self_signed(&key).unwrap();
        let files = Directory::new();
        files.write("ca.pem", &certificate.pem());
        Self { files, authority: Issuer::new(params, key) }
    }

    fn issue(&self, name: &str) {
        let key = KeyPair::generate().unwrap();
        let certificate = named(name).signed_by(&key, &self.authority).unwrap();
        self.files.write(&format!("{name}.pem"), &certificate.pem());
        self.files.write(&format!("{name}.key"), &key.serialize_pem());
    }

    /// Connects a client with a certificate for this name.
    async fn client(&self, name: &str, endpoint: &str) -> ZenohClient {
        self.issue(name);
        let mut client = config("client", &[], &[endpoint]);
        let path = |name: &str| json!(self.files.file(name)).to_string();
        for (key, value) in [
            ("root_ca_certificate", path("ca.pem")),
            ("connect_certificate", path(&format!("{name}.pem"))),
            ("connect_private_key", path(&format!("{name}.key"))),
            ("enable_mtls", "true".to_owned()),
        ] {
            client.insert_json5(&format!("transport/link/tls/{key}"), &value).unwrap();
        }
        ZenohClient::with(client).await
    }
}

fn named(name: &str) -> CertificateParams {
    let mut params = CertificateParams::new(["localhost".to_owned(), "gateway".to_owned()]).unwrap();
    params.distinguished_name.push(DnType::CommonName, name);
    params
}

/// The shipped file, with these certificates and a free loopback port.
fn shipped(certificates: &Certificates) -> String {
    let text = std::fs::read_to_string(SHIPPED).unwrap();
    let text = text.replace("/etc/wsg-gateway", certificates.files.path());
    let changed = text.replace("quic/0.0.0.0:7447", "quic/localhost:0");
    assert!(changed.contains("localhost:0") && !changed.contains("/etc/"), "{changed}");
    changed
}

async fn moves_nothing(client: &ZenohClient, command: &str, payload: &Value) -> bool {
    let key = format!("wsg/v1/gateway/g/command/{command}");
    client.all(&key, payload.to_string()).await.iter().all(|(_, answer)| answer.is_err())
}

/// Starts a gateway with the shipped file, and returns it with its proxy, its device and its endpoint.
async fn served(certificates: &Certificates) -> (Gateway, Proxy, Simulator, String) {
    certificates.issue("gateway");
    let own = certificates.files.write("zenoh.json5", &shipped(certificates));
    let toml = certificates.files.write("gateway.toml", &format!("[zenoh]\nconfig = {own:?}\n"));
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gripper = format!("g=tcp://{}", proxy.address);
    let gateway = Gateway::start_without_zenoh_defaults(&["--gripper", &gripper, "--config", &toml]).await;
    gateway.until_link("connected").await;
    let endpoint = gateway.word_after("Zenoh: ").await;
    let port = endpoint.rsplit(':').next().unwrap();
    let endpoint = format!("quic/localhost:{port}");
    (gateway, proxy, device, endpoint)
}

#[tokio::test(flavor = "multi_thread")]
async fn observer_reads_and_stops_but_moves_nothing() {
    let certificates = Certificates::new();
    let (gateway, proxy, _device, endpoint) = served(&certificates).await;
    let observer = certificates.client("observer", &endpoint).await;
    let received = observer.subscribe("wsg/v1/gateway/g/*").await;
    received.until("wsg/v1/gateway/g/state", |state| state["link"] == "connected").await;
    assert_eq!(observer.ask("wsg/v1/gateway/g/state", &Value::Null).await.unwrap()["gripper"], "g");
    assert_eq!(observer.ask("wsg/v1/gateway/fleet", &Value::Null).await.unwrap()["grippers"][0]["gripper"], "g");
    for operation in all().filter(|operation| operation.right == Right::Read) {
        let of_gripper = if operation.is_of_gripper() { "/g" } else { "" };
        let key = format!("wsg/v1/gateway{of_gripper}/command/{}", operation.name);
        assert!(!observer.all(&key, "").await.is_empty(), "{key} gets no reply");
    }
    observer.tokens("wsg/v1/**").await.until("wsg/v1/gateway/g/alive", |body| *body == "").await;
    let before = proxy.frames.len();
    for command in ["home", "stop", "lease.take", "settings.force-limit.set", "acknowledge"] {
        assert!(moves_nothing(&observer, command, &json!({})).await, "{command}");
    }
    assert!(moves_nothing(&observer, "*", &json!({})).await);
    assert!(proxy.frames.since(before).iter().all(|frame| !MOTIONS.contains(&frame.id)), "no motion is sent");
    assert_eq!(gateway.state().await["lease_holder"], Value::Null);

    let operator = certificates.client("robot-1", &endpoint).await;
    assert_eq!(operator.command("home", &json!({})).await.unwrap()["outcome"], "SUCCESS");
    observer.put("wsg/v1/fast-stop", "an observer").await;
    let state = gateway.until("the gripper stops", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(state["fast_stop_reason"], "an observer");
    let acknowledge = json!({"fast_stop_id": state["fast_stop_id"]});
    assert!(moves_nothing(&observer, "acknowledge", &acknowledge).await);
    operator.command("acknowledge", &acknowledge).await.unwrap();
    observer.command("fast-stop", &json!({})).await.unwrap();

    let stranger = certificates.client("stranger", &endpoint).await;
    assert!(moves_nothing(&stranger, "home", &json!({})).await);
    assert!(stranger.all("wsg/v1/gateway/g/state", "").await.is_empty(), "an unknown name reads nothing");
    eventually("the observer gets events", async || (!received.of("wsg/v1/gateway/g/event").is_empty()).then_some(()))
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robot_commands_only_under_its_own_name() {
    let certificates = Certificates::new();
    let (gateway, _proxy, _device, endpoint) = served(&certificates).await;
    let robot = certificates.client("robot-1", &endpoint).await;
    let other = certificates.client("cell-8", &endpoint).await;
    let (tokens, received) = (other.tokens("wsg/v1/**").await, other.subscribe("wsg/v1/gateway/**").await);

    let mut declared = Vec::new();
    for key in ["client/robot-2", "instance/1234", "alive", "client/robot-1"] {
        let token = robot.session.liveliness().declare_token(format!("wsg/v1/gateway/{key}"));
        declared.push(token.await.unwrap());
    }
    // Permitted tokens declared earlier are visible by then.
    tokens.until("wsg/v1/gateway/client/robot-1", |body| *body == "").await;
    let own: Vec<_> = tokens.all().into_iter().map(|(key, _)| key).collect();
    for foreign in ["client/robot-2", "instance/1234"] {
        assert!(!own.contains(&format!("wsg/v1/gateway/{foreign}")), "{own:?}");
    }
    robot.put("wsg/v1/gateway/h/state", "spoofed").await;
    let spoof = |query: zenoh::query::Query| drop(query);
    robot.session.declare_queryable("wsg/v1/gateway/h/command/*").callback(spoof).background().await.unwrap();
    let lease = robot.command("lease.take", &json!({"holder": "robot-1"})).await.unwrap();
    assert_eq!(lease["bound_to"], "token");
    let home = robot.command("home", &json!({"lease": lease["token"]})).await.unwrap();
    assert_eq!(home["outcome"], "SUCCESS");
    assert!(other.all("wsg/v1/gateway/h/command/home", "").await.is_empty(), "a robot's queryable is rejected");
    received.until("wsg/v1/gateway/g/event", |event| event["phase"] == "done").await;
    assert_eq!(received.of("wsg/v1/gateway/h/state"), [] as [Value; 0], "a robot's publication is rejected");
    drop(gateway);
}
