//! The command line: startup, errors and output.

use std::fs::Permissions;
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

use serde_json::json;

use crate::harness::{Directory, Gateway, Simulator, run};

/// Runs a command line that must fail, and returns its standard error.
async fn refused(arguments: &[&str]) -> String {
    let ended = run(arguments).await;
    assert!(!ended.status.success(), "{arguments:?} succeeds: {ended:?}");
    ended.stderr
}

#[tokio::test]
async fn startup_prints_addresses_and_a_command_to_try() {
    let device = Simulator::start(&["--model", "wsg32"]).await;
    assert_eq!(device.stdout(), format!("a simulated wsg32 at tcp://{}", device.address));
    let gateway = Gateway::start(&["--name", "cell-7", "--gripper", &format!("g=tcp://{}", device.address)]).await;
    let url = gateway.url("/");
    crate::harness::eventually("the line to try", async || gateway.stdout().contains("try: ").then_some(())).await;
    let said = gateway.stdout();
    for expected in [
        format!("serves cell-7 at {url}"),
        format!("g        tcp://{}", device.address),
        format!("documentation: {url}docs"),
        format!("guides: {url}docs/guide"),
        format!("try: curl -X POST {url}api/v1/grippers/g/home"),
    ] {
        assert!(said.contains(&expected), "{expected:?} in {said}");
    }
}

#[tokio::test]
async fn wrong_argument_is_named_with_a_remedy() {
    for (arguments, expected) in [
        (&["--listen", "0.0.0.0:0"][..], "--insecure"),
        (&["--listen", "nowhere"], "127.0.0.1:8080"),
        (&["--gripper", "left"], "left=tcp://192.168.1.20:1000"),
        (&["--gripper", "g=serial:///dev/ttyUSB0?baud=1"], "baud=1 must be one of 1200"),
        (&["--gripper", "g=can://can0?tx=0x800"], "0x0 to 0x7FF"),
        (&["sim", "serial://ttyUSB0"], "serial://pty"),
        (&["sim", "udp://127.0.0.1:0?reply_port=0"], "1 to 65535"),
        (&["sim", "tcp://127.1:0"], "not a plain IPv4 address"),
        (&["sim", "udp://192.168.001.020"], "without leading zeros"),
        (&["sim", "tcp://127.0.0.1:0?colour=red"], "unknown option colour: use part_mm"),
        (&["sim", "udp://127.0.0.1:0?part_mm=500"], "part_mm is \"500\"; it must be a width from 0 to 110"),
        (&["sim", "udp://127.0.0.1:0?colour=red"], "options of udp: reply_port"),
        (&["decode", "--follow", "http://127.1:8080"], "not a plain IPv4 address"),
        (&["reload", "--url", "http://192.168.001.020/"], "without leading zeros"),
        (&["discover", "--subnet", "192.168.001.0/24"], "without leading zeros"),
        (&["init", "--listen", "127.1:8443", "nowhere"], "--listen"),
        (&["init", "--host", "127.1", "nowhere"], "not a plain IPv4 address"),
        (&["sim", "tcp://127.0.0.1:0", "--control", "127.1:0"], "--control"),
        (&["sim", "tcp://127.0.0.1:0", "--control", "0.0.0.0:0"], "loopback"),
        (&["--gripper", "Left=sim://wsg50"], "a-z"),
        (&["--gripper", "a=sim://wsg50", "--gripper", "a=sim://wsg50"], "give each its own"),
        (&["--gripper", "g=sim://wsg99"], "wsg50"),
        (&["--gripper", "g=sim://wsg50?part_mm=500"], "110"),
        (&["--config", "no-such-file.toml"], "no-such-file.toml: does not exist: check the path"),
        (&["sim", "tcp://127.0.0.1:0", "--model", "wsg99"], "wsg50"),
        (&["sim"], "URL"),
        (&["token", "create", "--name", "a", "--role", "admin"], "use one of stop, observer, operator, supervisor"),
        (&["--nonsense"], "--nonsense"),
        (&["--zenoh-listen", "tcp/0.0.0.0:0"], "--insecure"),
        (&["--zenoh-connect", "nowhere"], "tcp/127.0.0.1:7447"),
    ] {
        let said = refused(arguments).await;
        assert!(said.contains(expected), "{arguments:?}: {said}");
        assert!(!said.contains("panicked"), "{said}");
    }
}

#[tokio::test]
async fn non_loopback_address_needs_insecure() {
    let said = refused(&["check", "--listen", "0.0.0.0:8080"]).await;
    assert!(said.contains("loopback"), "{said}");
    assert!(run(&["check", "--listen", "0.0.0.0:8080", "--insecure"]).await.status.success());
}

#[tokio::test]
async fn occupied_port_is_a_clear_error_and_sends_no_frame() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let device = Simulator::start(&[]).await;
    let proxy = crate::harness::Proxy::to(device.address);
    let said = refused(&["--listen", &address, "--gripper", &format!("g=tcp://{}", proxy.address)]).await;
    assert!(said.contains(&format!("cannot listen on {address}")) && said.contains("--listen"), "{said}");
    assert_eq!(proxy.frames.len(), 0);
    let said = refused(&["sim", &format!("tcp://{address}")]).await;
    assert!(said.contains("cannot listen: choose another address, or stop the program that listens there"), "{said}");
}

#[tokio::test]
async fn check_prints_a_summary_or_the_wrong_line() {
    let files = Directory::new();
    let right = files.write("right.toml", "name = \"cell\"\n[grippers.a]\nurl = \"sim://wsg50\"\n");
    let ended = run(&["check", "--config", &right]).await;
    assert!(ended.status.success(), "{ended:?}");
    assert!(ended.stdout.contains("cell serves 1 gripper at 127.0.0.1:8080"), "{ended:?}");
    for (text, line) in [
        ("name = \"cell\"\nnonsense = 1\n", 2),
        ("[grippers.a]\nurl = \"sim://wsg99\"\n", 2),
        ("\n\nlisten = \"nowhere\"\n", 3),
        ("name = \"Cell\"\n", 1),
        ("name = \n", 1),
        ("journal_max_age_days = 0\n", 1),
    ] {
        let wrong = files.write("wrong.toml", text);
        let said = refused(&["check", "--config", &wrong]).await;
        assert!(said.contains(&format!("wrong.toml:{line}:")), "{text:?}: {said}");
    }
}

#[tokio::test]
async fn check_finds_a_device_under_two_names() {
    let one = "left=tcp://localhost:1000";
    let said = refused(&["check", "--gripper", one, "--gripper", "right=tcp://127.0.0.1:1000"]).await;
    assert!(said.contains("left and right cannot both be served: both are at tcp://127.0.0.1:1000"), "{said}");
    let ended = run(&["check", "--gripper", one, "--gripper", "right=tcp://no-such-host.invalid:1000"]).await;
    assert!(ended.status.success(), "a host that is unknown now is no mistake: {ended:?}");
}

#[tokio::test]
async fn configuration_guide_has_a_valid_file() {
    let guide = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/guide/configuration.md");
    let guide = std::fs::read_to_string(guide).unwrap();
    let (_, example) = guide.split_once("```toml\n").expect("an example in TOML");
    let (example, _) = example.split_once("```").unwrap();
    let files = Directory::new();
    assert!(run(&["certificate", files.path()]).await.status.success());
    std::fs::copy(files.file("certificate.pem"), files.file("clients-ca.pem")).unwrap();
    let ended = run(&["check", "--config", &files.write("guide.toml", example)]).await;
    assert!(ended.status.success() && ended.stderr.is_empty(), "{ended:?}");
}

#[tokio::test]
async fn check_names_files_that_cannot_be_used() {
    let files = Directory::new();
    let config = &files.write("gateway.toml", "\n[tls]\ncertificate = \"a.pem\"\nkey = \"key.pem\"\n");
    for arguments in [&["check", "--config", config][..], &["--listen", "127.0.0.1:0", "--config", config]] {
        let said = refused(arguments).await;
        assert!(said.contains("gateway.toml:3: certificate: ") && said.contains("a.pem: No such file"), "{said}");
    }
    assert!(run(&["certificate", files.path()]).await.status.success());
    std::fs::rename(files.file("certificate.pem"), files.file("a.pem")).unwrap();
    assert!(run(&["check", "--config", config]).await.status.success());
    std::fs::remove_file(files.file("key.pem")).unwrap();
    let said = refused(&["check", "--config", config]).await;
    assert!(said.contains("gateway.toml:4: key: ") && said.contains("check the path"), "{said}");
    let tokens = files.write("tokens.json", "{}");
    std::fs::set_permissions(&tokens, Permissions::from_mode(0o644)).unwrap();
    let said = refused(&["check", "--tokens", &tokens]).await;
    assert!(said.contains("tokens.json can be read by others (mode 644): run chmod 600"), "{said}");
}

#[tokio::test]
async fn unknown_gripper_of_a_client_or_token_is_a_warning() {
    let files = Directory::new();
    let client = "[[clients]]\nname = \"plc\"\naddress = \"192.168.1.10\"\nrole = \"operator\"\ngrippers = [\"lft\"]\n";
    let config = &files.write("gateway.toml", &format!("{client}[grippers.left]\nurl = \"sim://wsg50\"\n"));
    let checked = run(&["check", "--config", config]).await;
    assert!(checked.status.success(), "{checked:?}");
    let expected = "gateway.toml:5: client plc names the unknown gripper lft: this gateway has left";
    assert!(checked.stderr.starts_with("warning: ") && checked.stderr.contains(expected), "{checked:?}");
    let create = ["token", "--config", config, "create", "--name", "robot", "--role", "operator", "--gripper"];
    let created = run(&[&create[..], &["lefft"]].concat()).await;
    assert!(created.status.success() && created.stdout.starts_with("wsg_"), "{created:?}");
    let warned = created.stderr.lines().next();
    assert_eq!(warned, Some("warning: no gripper is named lefft: this gateway has left"));
}

#[tokio::test]
async fn openapi_prints_the_committed_document() {
    let ended = run(&["openapi"]).await;
    let checked_in = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/openapi/openapi.json")).unwrap();
    assert!(ended.status.success());
    assert!(ended.stdout.trim_end() == checked_in.trim_end(), "another document than openapi/openapi.json");
}

#[tokio::test]
async fn frames_are_decoded_and_encoded() {
    let encoded = run(&["decode", "--encode", "FastStop"]).await;
    assert!(encoded.status.success(), "{encoded:?}");
    let hex = encoded.stdout.replace(char::is_whitespace, "").to_ascii_uppercase();
    assert!(hex.starts_with("AAAAAA230000"), "{encoded:?}");
    let files = Directory::new();
    let decoded = run(&["decode", &files.write("frames.hex", &hex)]).await;
    assert!(decoded.stdout.contains("FastStop"), "{decoded:?}");
}

#[tokio::test]
async fn decode_continues_after_a_wrong_line_and_exits_with_1() {
    let files = Directory::new();
    let ended = run(&["decode", &files.write("wrong.hex", "nonsense\nAAAAAA230000AC1C\n")]).await;
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    assert!(ended.stdout.contains("line 1 not decoded") && ended.stdout.contains("FastStop"), "{ended:?}");
    assert!(ended.stderr.contains("could not be decoded: 1"), "{ended:?}");
}

#[test]
fn closed_output_pipe_is_not_an_error() {
    let files = Directory::new();
    let frames = files.write("enough.hex", &"AAAAAA230000AC1C\n".repeat(10_000));
    for arguments in [
        &["decode", &frames][..],
        &["decode", "--encode", "FastStop"],
        &["check", "--gripper", "g=sim://wsg50"],
        &["openapi"],
        &["--help"],
    ] {
        let (reader, closed) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_wsg-gateway"));
        let ended = command.env_clear().args(arguments).stdout(closed).output().unwrap();
        assert!(ended.status.success() && ended.stderr.is_empty(), "{arguments:?}: {ended:?}");
    }
}

#[tokio::test]
async fn package_files_describe_every_subcommand() {
    let files = Directory::new();
    assert!(run(&["package-files", files.path()]).await.status.success());
    let read = |path: &str| std::fs::read_to_string(files.file(path)).unwrap();
    for page in ["wsg-gateway", "wsg-gateway-doctor", "wsg-gateway-journal-backup"] {
        assert!(read(&format!("man/{page}.1")).contains(".SH OPTIONS"), "{page}");
    }
    for shell in ["wsg-gateway.bash", "wsg-gateway.fish", "_wsg-gateway"] {
        assert!(read(&format!("completions/{shell}")).contains("discover"), "{shell}");
    }
}

#[tokio::test]
async fn doctor_exits_with_1_and_names_the_problem() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let flags = ["--gripper", "g=sim://wsg50", "--zenoh-mode", "off", "--journal", ":memory:", "--listen"];
    let ended = run(&[&["doctor"], &flags[..], &[&address]].concat()).await;
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    assert!(ended.stdout.contains(&format!("PROBLEM  ports          cannot listen on {address}")), "{ended:?}");
    assert!(ended.stderr.contains("1 problem found"), "{ended:?}");
    let ended = run(&[&["doctor"], &flags[..], &["127.0.0.1:0"]].concat()).await;
    assert!(ended.status.success(), "{ended:?}");
}

#[tokio::test]
async fn doctor_asks_the_running_gateway_about_its_grippers() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    let info = gateway.send(gateway.request("GET", "/readyz")).await.ok();
    let flags = ["doctor", "--zenoh-mode", "off", "--journal", ":memory:"];
    let url = gateway.url("/");
    let listen = url.trim_start_matches("http://").trim_end_matches('/');
    let own = ["--name", info["gateway"].as_str().unwrap(), "--listen", listen];
    let doctor = async |gripper: &str| {
        let ended = run(&[&flags[..], &own, &["--gripper", gripper]].concat()).await;
        assert!(ended.status.success(), "{ended:?}");
        ended.stdout
    };
    let g = format!("g=tcp://{}", device.address);
    assert!(doctor(&g).await.contains("ok       gripper        g is connected to the running gateway"));
    for (gripper, expected) in [
        (g.replace("g=", "h="), "the running gateway does not have h yet: reload the gateway"),
        ("g=tcp://127.0.0.1:1".to_owned(), "not at tcp://127.0.0.1:1: reload the gateway"),
    ] {
        let said = doctor(&gripper).await;
        assert!(said.contains("warning  gripper") && said.contains(expected), "{said}");
    }
    gateway.post("disconnect", &json!({})).await.ok();
    let said = doctor(&g).await;
    assert!(
        said.contains("warning  gripper        g was released: by http:127.0.0.1; a `connect` request restores"),
        "{said}"
    );
}

#[tokio::test]
async fn discover_asks_before_it_contacts_a_device() {
    let device = Simulator::start(&[]).await;
    let proxy = crate::harness::Proxy::to(device.address);
    let port = proxy.address.port().to_string();
    let search = ["discover", "--network-only", "--subnet", "127.0.0.1/32", "--port", &port];
    let said = refused(&search).await;
    assert!(said.contains("would contact 1 network addresses") && said.contains("--yes"), "{said}");
    assert_eq!(proxy.frames.len(), 0);
    let ended = run(&[&search[..], &["--yes"]].concat()).await;
    assert!(ended.stdout.contains(&format!("gripper  tcp://{}", proxy.address)), "{ended:?}");
    assert!(ended.stdout.ends_with("grippers found: 1"), "{ended:?}");
}

#[tokio::test]
async fn help_and_version_are_printed() {
    let help = run(&["--help"]).await;
    assert!(help.status.success());
    for expected in ["--gripper", "--listen", "--insecure", "--journal", "sim", "check", "openapi"] {
        assert!(help.stdout.contains(expected), "{expected}");
    }
    let version = run(&["--version"]).await.stdout;
    for expected in
        [env!("CARGO_PKG_VERSION"), "commit: ", "HTTP API: /api/v1", "WebSocket: wsg.v1", "journal format: "]
    {
        assert!(version.contains(expected), "{expected} in {version}");
    }
}

#[allow(dead_code, reason = "Cargo runs its main function")]
#[path = "../../../deploy/build.rs"]
mod build_script;

#[test]
fn build_from_a_clone_names_its_commit() {
    let git = std::process::Command::new("git").args(["rev-parse", "--short=12", "HEAD"]).output();
    let head = git.ok().filter(|output| output.status.success());
    let head = head.map(|output| String::from_utf8(output.stdout).unwrap().trim().to_owned());
    let commit = build_script::commit();
    assert_eq!(commit.as_deref().map(|commit| commit.trim_end_matches("-changed")), head.as_deref());
}
