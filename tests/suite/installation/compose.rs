//! `docker-compose.yml` and `deploy/Dockerfile`: their references exist, and their commands run as plain processes.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use serde::Deserialize;
use serde_json::Value;

use crate::harness::{Gateway, Process, eventually};
use crate::zenoh::router::Router;

#[derive(Debug, Deserialize)]
struct Compose {
    services: BTreeMap<String, Service>,
    volumes: BTreeMap<String, Option<Value>>,
}

#[derive(Debug, Deserialize)]
struct Service {
    image: String,
    build: Option<Build>,
    #[serde(default)]
    command: Vec<String>,
    #[serde(default)]
    ports: Vec<String>,
    #[serde(default)]
    volumes: Vec<String>,
    #[serde(default)]
    depends_on: Vec<String>,
    #[serde(default)]
    sysctls: BTreeMap<String, u16>,
}

#[derive(Debug, Deserialize)]
struct Build {
    context: String,
    dockerfile: String,
}

fn top() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    std::fs::read_to_string(top().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn compose() -> Compose {
    serde_saphyr::from_str(&read("docker-compose.yml")).unwrap()
}

/// Arguments of each instruction of this name, with continuation lines joined.
fn instructions(name: &str) -> Vec<String> {
    let text = read("deploy/Dockerfile").replace("\\\n", " ");
    let of =
        |line: &str| line.strip_prefix(name).and_then(|rest| rest.strip_prefix(' ')).map(|rest| rest.trim().to_owned());
    text.lines().filter_map(of).collect()
}

/// Version of a crate in `Cargo.lock`.
fn locked(name: &str) -> String {
    let lock: toml::Table = read("Cargo.lock").parse().unwrap();
    let package = lock["package"].as_array().unwrap().iter().find(|package| package["name"].as_str() == Some(name));
    package.unwrap()["version"].as_str().unwrap().to_owned()
}

#[test]
fn dockerfile_sources_exist() {
    let manifest: toml::Table = read("Cargo.toml").parse().unwrap();
    let rust = format!(
        "docker.io/library/rust:{}-bookworm AS build",
        manifest["workspace"]["package"]["rust-version"].as_str().unwrap()
    );
    assert!(instructions("FROM").contains(&rust), "{:?}", instructions("FROM"));
    let ignored = read(".dockerignore");
    for copied in instructions("COPY").iter().filter(|copied| !copied.starts_with("--from")) {
        let sources: Vec<_> = copied.split_whitespace().collect();
        for source in &sources[..sources.len() - 1] {
            assert!(top().join(source).exists(), "{source}");
            assert!(ignored.lines().any(|line| line.strip_prefix('!') == Some(source)), "{source} is ignored");
        }
    }
    let bin = manifest["bin"][0]["name"].as_str().unwrap();
    assert!(instructions("RUN").contains(&format!("cargo build --release --locked --bin {bin} --features jemalloc")));
    assert!(instructions("COPY").contains(&format!("--from=build /src/target/release/{bin} /usr/local/bin/{bin}")));
    assert_eq!(instructions("ENTRYPOINT"), [format!("[\"{bin}\"]")]);
    // The gateway is not root, and keeps its journal in its state directory.
    let home = format!("/var/lib/{bin}");
    assert!(
        instructions("USER") == [bin]
            && instructions("RUN").iter().any(|run| run.contains(&format!("--home-dir {home} {bin}")))
    );
    assert_eq!(instructions("ENV"), [format!("STATE_DIRECTORY={home}")]);
    // Simulated devices store nothing, yet each would get a volume.
    assert!(instructions("VOLUME").is_empty());
}

#[tokio::test]
async fn health_check_detects_the_gateway() {
    let check = instructions("HEALTHCHECK").remove(0);
    let command: Vec<String> = serde_json::from_str(check.split_once("CMD ").unwrap().1).unwrap();
    let gateway = Gateway::start(&["--gripper", "g=sim://wsg50"]).await;
    let url = gateway.url("/");
    let (_, port) = url.trim_end_matches('/').rsplit_once(':').unwrap();
    let exposed = instructions("EXPOSE").remove(0);
    let run = |command: &[String]| Command::new(&command[0]).args(&command[1..]).output().unwrap();
    let at = |port: &str| command.iter().map(|word| word.replace(&exposed, port)).collect::<Vec<_>>();
    assert_ne!(at(port), command, "the check uses the exposed port");
    let healthy = run(&at(port));
    assert!(healthy.status.success(), "{healthy:?}");
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    assert!(!run(&at(&free.to_string())).status.success());
}

#[test]
fn service_references_exist() {
    let compose = compose();
    let exposed = instructions("EXPOSE").remove(0);
    for (name, service) in &compose.services {
        for other in &service.depends_on {
            assert!(compose.services.contains_key(other), "{name} depends on {other}");
        }
        if let Some(Build { context, dockerfile }) = &service.build {
            assert!(top().join(context).join(dockerfile).is_file(), "{name}: {dockerfile}");
        }
        let is_gateway = service.image == "wsg-gateway";
        match service.image.split_once(':') {
            Some(("eclipse/zenoh", version)) => assert_eq!(version, locked("zenoh"), "{name}: Zenoh version"),
            version => assert!(is_gateway || version.is_some(), "{name}: {}", service.image),
        }
        for volume in &service.volumes {
            let (source, place) = volume.split_once(':').unwrap();
            if source.starts_with("./") {
                assert!(top().join(source).exists() && place.ends_with(":ro"), "{name}: {volume}");
                continue;
            }
            assert!(compose.volumes.contains_key(source), "{name}: {source}");
            let is_state = instructions("ENV").contains(&format!("STATE_DIRECTORY={place}"));
            assert!(is_state || !is_gateway, "{name}: {place}");
        }
        let is_privileged = service.command.iter().any(|word| word == "tcp://0.0.0.0:1000");
        let unprivileged_from = service.sysctls.get("net.ipv4.ip_unprivileged_port_start");
        assert_eq!(
            unprivileged_from.copied(),
            is_privileged.then_some(0),
            "{name}: a low port without root needs the sysctl"
        );
        for port in &service.ports {
            assert!(port.starts_with("127.0.0.1:"), "{name}: {port}");
            if is_gateway {
                assert!(port.ends_with(&format!(":{exposed}")), "{name}: {port}");
                assert!(service.command.contains(&format!("--listen=0.0.0.0:{exposed}")), "{name}: {port}");
            }
        }
    }
    let built: Vec<_> = compose.services.values().filter(|service| service.build.is_some()).collect();
    assert!(built.len() == 1 && built[0].image == "wsg-gateway", "the image is built once: {built:?}");
}

/// Starts a service's simulated device, and returns its address.
async fn device(service: &Service) -> (Process, String) {
    let command: Vec<_> = service.command.iter().map(|word| word.replace("0.0.0.0:1000", "127.0.0.1:0")).collect();
    assert_ne!(command, service.command);
    let process = Process::start(&command.iter().map(String::as_str).collect::<Vec<_>>());
    let address = process.word_after(" at tcp://").await;
    (process, address)
}

#[tokio::test(flavor = "multi_thread")]
async fn services_run_as_processes_and_form_a_fleet() {
    let compose = compose();
    let (_left, left) = device(&compose.services["left"]).await;
    let (_right, right) = device(&compose.services["right"]).await;
    let router = Router::start();
    let config = top().join("deploy/compose/wsg-gateway.toml");
    let gateway = async |name: &str| {
        let arguments: Vec<_> = compose.services[name]
            .command
            .iter()
            .filter(|word| !word.starts_with("--listen="))
            .map(|word| {
                word.replace("left:1000", &left)
                    .replace("right:1000", &right)
                    .replace("tcp/router:7447", router.endpoint())
                    .replace("/etc/wsg-gateway.toml", config.to_str().unwrap())
            })
            .chain(["--zenoh-listen=tcp/127.0.0.1:0".to_owned()])
            .collect();
        Gateway::start(&arguments.iter().map(String::as_str).collect::<Vec<_>>()).await
    };
    let (cell, office) = (gateway("cell").await, gateway("office").await);
    // Prometheus uses the name of the gateway's service as the host.
    let scrape = cell.request("GET", "/metrics").header("Host", "cell:8080");
    assert_eq!(scrape.send().await.unwrap().status(), 200);
    eventually("the fleet", async || {
        let Value::Array(grippers) = office.get("/api/v1/fleet").await.ok()["grippers"].take() else { return None };
        let connected = grippers.iter().filter(|gripper| gripper["link"] == "connected");
        let mut names: Vec<_> =
            connected.map(|gripper| format!("{}/{}", gripper["gateway"], gripper["gripper"])).collect();
        names.sort();
        (names == [r#""cell"/"left""#, r#""cell"/"right""#, r#""office"/"spare""#]).then_some(())
    })
    .await;
}
