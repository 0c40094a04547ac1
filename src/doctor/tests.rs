//! Planted faults, each of which must be named with its remedy.

use std::fs;
use std::net::{TcpListener, UdpSocket};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use rustix::fs::{OFlags, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use super::*;
use crate::access::{NewToken, Role, TokenFile};
use crate::config::{ZenohFlags, ZenohMode};
use crate::connections::self_signed::SelfSigned;
use crate::daemon::{ServedDevice, SimulatedDevice, serve_device};
use crate::transport::{Address, TcpAddress};
use crate::wsg::frame::encode_with;
use crate::wsg::id;

/// Maximum number of searches for the bit rate of a pty.
const TRIES: usize = 3;

/// Temporary directory of one test.
struct Place(PathBuf);

impl Place {
    fn new() -> Self {
        let path = std::env::temp_dir().join(format!("wsg-doctor-{}", uuid::Uuid::now_v7()));
        fs::create_dir(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str, mode: u32, text: &str) -> PathBuf {
        let path = self.0.join(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        path
    }

    /// Flags of a gateway that serves a gripper at this address.
    fn flags(&self, gripper: impl fmt::Display) -> Flags {
        Flags {
            grippers: vec![format!("left={gripper}")],
            listen: Some("127.0.0.1:0".to_owned()),
            journal: Some(self.0.join("journal.db").display().to_string()),
            zenoh: ZenohFlags { zenoh_mode: Some(ZenohMode::Off), ..ZenohFlags::default() },
            ..Flags::default()
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).unwrap();
    }
}

async fn device(url: &str) -> ServedDevice {
    serve_device(&url.parse().unwrap(), SimulatedDevice::of_model("wsg50").unwrap()).await.unwrap()
}

fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

async fn findings(flags: &Flags) -> Vec<Diagnosis> {
    let mut findings = Vec::new();
    examine(flags, |finding| findings.push(finding.clone())).await;
    findings
}

/// Checks that the only problem is of this check, and has these texts.
async fn assert_problem(flags: &Flags, check: &str, texts: &[&str]) {
    assert_only(&findings(flags).await, check, texts);
}

fn assert_only(findings: &[Diagnosis], check: &str, texts: &[&str]) {
    let problems: Vec<_> = findings.iter().filter(|finding| finding.severity == Severity::Problem).collect();
    let [problem] = problems[..] else { panic!("not one problem: {findings:#?}") };
    assert!(problem.check == check && texts.iter().all(|text| problem.text.contains(text)), "{problem}");
}

#[tokio::test]
async fn healthy_installation_has_no_problem_and_the_device_is_left_properly() {
    let (place, device) = (Place::new(), device("tcp://127.0.0.1:0").await);
    let findings = findings(&place.flags(&device.address)).await;
    assert!(findings.iter().all(|finding| finding.severity != Severity::Problem), "{findings:#?}");
    let text = &findings.last().unwrap().text;
    assert!(text.contains("WSG 50, serial number") && text.contains("firmware 4"), "{text}");
    let frames: Vec<_> = device.switch.received().await.unwrap().iter().map(|frame| frame.id).collect();
    assert_eq!(frames, [id::GET_SYSTEM_INFO, id::GET_DEVICE_TAG, id::DISCONNECT_ANNOUNCEMENT]);
    assert!(!device.switch.snapshot().await.unwrap().fast_stop);
}

#[tokio::test]
async fn invalid_configuration_is_named_with_its_line() {
    let place = Place::new();
    let config = place.file("gateway.toml", 0o600, "name = \"cell\"\nlistne = 1\n");
    let flags = Flags { config: Some(config), ..Flags::default() };
    assert_problem(&flags, "configuration", &["gateway.toml:2: unknown field `listne`"]).await;
}

#[tokio::test]
async fn taken_port_is_named() {
    let (place, taken) = (Place::new(), TcpListener::bind("127.0.0.1:0").unwrap());
    let address = taken.local_addr().unwrap().to_string();
    let flags = Flags { listen: Some(address.clone()), ..place.flags("sim://wsg50") };
    assert_problem(&flags, "ports", &[&address, "stop the program that listens there"]).await;
    let flags = Flags { modbus: Some(address.clone()), ..place.flags("sim://wsg50") };
    assert_problem(&flags, "ports", &[&address, "(Modbus)", "stop the program that listens there"]).await;
}

#[tokio::test]
async fn program_that_may_be_the_gateway_is_not_taken_for_it() {
    let (place, taken) = (Place::new(), TcpListener::bind("127.0.0.1:0").unwrap());
    let address = taken.local_addr().unwrap().to_string();
    let tokens = Some(place.0.join("tokens.json"));
    let guarded = Flags { listen: Some(address.clone()), tokens, ..place.flags("sim://wsg50") };
    // Without a lock file, the journal tells nothing.
    let uncertain = findings(&guarded).await;
    let warns = |finding: &&Diagnosis| finding.severity == Severity::Warning && finding.check == "gateway";
    assert!(
        uncertain.iter().any(|finding| warns(&finding) && finding.text.contains("a program answers")),
        "{uncertain:#?}"
    );
    place.file("journal.db-lock", 0o600, "");
    assert_problem(&guarded, "ports", &[&address, "stop the program that listens there"]).await;
}

#[tokio::test]
async fn missing_can_interface_is_named() {
    let place = Place::new();
    assert_problem(&place.flags("can://can9"), "gripper", &["left at can://can9", "can9 cannot be opened"]).await;
}

#[tokio::test]
async fn device_on_the_other_transport_is_found() {
    let (place, device) = (Place::new(), device("tcp://127.0.0.1:0").await);
    let Address::Tcp(TcpAddress { port, .. }) = device.address else { panic!("not TCP") };
    let flags = place.flags(format_args!("udp://127.0.0.1:{port}?local_port={}", free_port()));
    let found = format!("a gripper answers at tcp://127.0.0.1:{port} instead: write this URL");
    assert_problem(&flags, "gripper", &["does not answer", &found]).await;
}

#[tokio::test]
async fn second_client_of_a_device_is_named() {
    let (place, device) = (Place::new(), TcpListener::bind("127.0.0.1:0").unwrap());
    let address = device.local_addr().unwrap();
    let _other_gateway = std::net::TcpStream::connect(address).unwrap();
    let process = format!("(process {}) on this machine is connected", std::process::id());
    assert_problem(&place.flags(format_args!("tcp://{address}")), "gripper", &[&process, "accepts one client"]).await;
}

#[tokio::test]
async fn switched_off_device_is_named() {
    let place = Place::new();
    let device = format!("tcp://127.0.0.1:{}", free_port());
    assert_problem(&place.flags(&device), "gripper", &["onnection refused", "check power, cable and address"]).await;
}

/// Plays a device at 9600 baud on a pty until its port is dropped. At other bit rates, it answers as a real line would.
fn serial_device() -> (String, std::os::fd::OwnedFd) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let path = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    let port = open(path.as_str(), OFlags::RDWR | OFlags::NOCTTY, rustix::fs::Mode::empty()).unwrap();
    let mut settings = tcgetattr(&port).unwrap();
    settings.make_raw();
    tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
    let line = port.try_clone().unwrap();
    std::thread::spawn(move || {
        let mut request = [0; 64];
        let asks = [0xAA, 0xAA, 0xAA, id::GET_SYSTEM_INFO];
        while let Ok(count) = rustix::io::read(&master, &mut request[..]) {
            // After an exclusive client, the next one needs this.
            let _ = rustix::termios::ioctl_tiocnxcl(&line);
            let mut reply = Vec::new();
            if tcgetattr(&line).unwrap().output_speed() != 9600 {
                reply.extend([0x80, 0x7F]);
            } else if request[..count].windows(asks.len()).any(|part| part == asks) {
                encode_with(id::GET_SYSTEM_INFO, &mut reply, |out| out.extend([0, 0, 1, 3, 0x10, 0x42, 7, 0, 0, 0]));
            }
            let _ = rustix::io::write(&master, &reply);
        }
    });
    (path, port)
}

#[tokio::test]
async fn wrong_bit_rate_is_named_with_the_right_one() {
    let (place, (path, _port)) = (Place::new(), serial_device());
    let flags = place.flags(format_args!("serial://{path}?baud=115200"));
    let found = format!("a gripper answers at serial://{path}?baud=9600&stop_bits=1 instead");
    // On a busy machine, the kernel can deliver the bytes of a pty later than the search waits.
    let mut all = findings(&flags).await;
    for _ in 1..TRIES {
        if all.iter().any(|finding| finding.text.contains(&found)) {
            break;
        }
        all = findings(&flags).await;
    }
    assert_only(&all, "gripper", &["bytes arrive, but no frames", &found]);
}

#[tokio::test]
async fn secret_that_everybody_can_read_is_named() {
    let place = Place::new();
    let secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";
    let path = place.file("mes.secret", 0o644, secret).display().to_string();
    let webhook = "[[webhooks]]\nname = \"mes\"\nurl = \"http://127.0.0.1:1\"\n";
    let with_file = place.file("file.toml", 0o644, &format!("{webhook}secret_file = \"mes.secret\"\n"));
    let flags = Flags { config: Some(with_file), ..place.flags("sim://wsg50") };
    assert_problem(&flags, "secrets", &[&path, "chmod o= "]).await;
    let with_secret = place.file("secret.toml", 0o644, &format!("{webhook}secret = \"{secret}\"\n"));
    let flags = Flags { config: Some(with_secret.clone()), ..place.flags("sim://wsg50") };
    assert_problem(&flags, "secrets", &["secret.toml, which contains a secret"]).await;
    fs::set_permissions(with_secret, fs::Permissions::from_mode(0o640)).unwrap();
    assert!(findings(&flags).await.iter().all(|finding| finding.check != "secrets"));
}

#[tokio::test]
async fn token_file_that_others_can_read_is_named() {
    let place = Place::new();
    let tokens = place.0.join("tokens.json");
    let flags = Flags { tokens: Some(tokens.clone()), ..place.flags("sim://wsg50") };
    let (name, role) = ("plc7".parse().unwrap(), Role::Operator);
    let new = NewToken { name, role, grippers: None, expires_at: None };
    TokenFile::at(tokens.clone()).create(jiff::Timestamp::now(), new).unwrap();
    assert!(findings(&flags).await.iter().any(|finding| finding.text == "tokens: 1"));
    let other = Flags { tokens: Some(place.0.join("other.json")), ..flags.clone() };
    let missing = findings(&other).await.into_iter().find(|finding| finding.check == "tokens").unwrap();
    assert!(missing.severity == Severity::Warning && missing.text.contains("other.json does not exist"), "{missing}");
    fs::set_permissions(&tokens, fs::Permissions::from_mode(0o644)).unwrap();
    assert_problem(&flags, "tokens", &["tokens.json can be read by others (mode 644)", "run chmod 600"]).await;
}

/// Returns the time in so many days.
fn days(days: i64) -> jiff::Timestamp {
    jiff::Timestamp::now() + jiff::SignedDuration::from_hours(days * 24)
}

/// Whether one of these findings of a check begins with a text.
fn has(findings: &[&super::Diagnosis], check: &str, begin: &str) -> bool {
    findings.iter().any(|finding| finding.check == check && finding.text.starts_with(begin))
}

#[tokio::test]
async fn tokens_and_certificates_that_end_soon_are_named() {
    let place = Place::new();
    let file = TokenFile::at(place.0.join("tokens.json"));
    for (name, expires_at) in [("mes", None), ("old", Some(days(-1))), ("plc7", Some(days(5))), ("hmi", Some(days(60)))]
    {
        let new = NewToken { name: name.parse().unwrap(), role: Role::Operator, grippers: None, expires_at };
        file.create(days(-80), new).unwrap();
    }
    let made = SelfSigned::create("cell-7", &["localhost".to_owned()], days(-815)).unwrap();
    let certificate = place.file("certificate.pem", 0o644, &made.certificate);
    place.file("key.pem", 0o600, &made.key);
    let text = "[tls]\ncertificate = \"certificate.pem\"\nkey = \"key.pem\"\n[access]\ntokens = \"tokens.json\"\n";
    let flags = Flags { config: Some(place.file("gateway.toml", 0o600, text)), ..place.flags("sim://wsg50") };
    let findings = findings(&flags).await;
    let warnings: Vec<_> = findings.iter().filter(|finding| finding.severity == Severity::Warning).collect();
    assert!(has(&warnings, "tokens", "valid tokens: 3, expired ones: 1"), "{findings:#?}");
    assert!(has(&warnings, "tokens", "token old expired on 2"), "{findings:#?}");
    assert!(has(&warnings, "tokens", "token plc7 expires on 2"), "{findings:#?}");
    assert!(has(&warnings, "tls", &format!("certificate {} expires on 2", certificate.display())), "{findings:#?}");
    assert!(!findings.iter().any(|finding| finding.text.contains("hmi")), "{findings:#?}");
}

#[tokio::test]
async fn missing_journal_directory_is_named() {
    let place = Place::new();
    let journal = |path: &Path| Flags { journal: Some(path.display().to_string()), ..place.flags("sim://wsg50") };
    let file = place.file("file", 0o600, "");
    assert_problem(&journal(&file.join("journal.db")), "journal", &["is a file: set another --journal"]).await;
    let findings = findings(&journal(&place.0.join("unmounted/journal.db"))).await;
    let warning = findings.iter().find(|finding| finding.check == "journal").unwrap();
    assert_eq!(warning.severity, Severity::Warning);
    assert!(warning.text.contains("unmounted does not exist: check --journal and that its disk"), "{warning}");
}

#[tokio::test]
async fn bundle_has_the_findings_and_no_secret() {
    let place = Place::new();
    let text = "[[webhooks]]\nname = \"mes\"\nurl = \"http://127.0.0.1:1\"\nsecret = \"whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw\"\n";
    let flags = Flags { config: Some(place.file("gateway.toml", 0o600, text)), ..place.flags("sim://wsg50") };
    let (findings, path) = (findings(&flags).await, place.0.join("bundle.tar.gz"));
    write_bundle(&path, &flags, &findings, "wsg-gateway 1.2.3").await.unwrap();
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    let mut archive = tar::Archive::new(flate2::read::GzDecoder::new(fs::File::open(&path).unwrap()));
    let mut files = std::collections::BTreeMap::new();
    for entry in archive.entries().unwrap() {
        let mut entry = entry.unwrap();
        let name = entry.path().unwrap().display().to_string();
        files.insert(name, std::io::read_to_string(&mut entry).unwrap());
    }
    assert!(files["report.txt"].contains("left is simulated") && files["version.txt"].contains("1.2.3"));
    assert!(files["configuration.toml"].contains("REDACTED") && !files.values().any(|text| text.contains("MfKQ9r8")));
    assert!(write_bundle(&path, &flags, &findings, "").await.unwrap_err().to_string().contains("name a new file"));
}

#[tokio::test]
async fn discovery_finds_a_device_and_leaves_it_properly() {
    let device = device("tcp://127.0.0.1:0").await;
    let Address::Tcp(TcpAddress { port, .. }) = device.address else { panic!("not TCP") };
    let plan = |network: &str| discover::SearchPlan::new(&[network.parse().unwrap()], port, false);
    let mut found = Vec::new();
    plan("127.0.0.0/30").unwrap().run(|one| found.push(one.clone())).await;
    let [discovered] = &found[..] else { panic!("{found:?}") };
    assert!(discovered.is_device && discovered.text.starts_with("WSG 50, serial number"), "{discovered:?}");
    assert_eq!(discovered.address, device.address);
    let frames = device.switch.received().await.unwrap();
    assert_eq!(frames.last().unwrap().id, id::DISCONNECT_ANNOUNCEMENT);
    assert_eq!(plan("10.0.0.0/8"), Err(discover::TooManyAddresses));
}

#[tokio::test]
async fn broker_that_is_away_and_its_exposed_password_are_named() {
    let place = Place::new();
    let path = place.file("broker.password", 0o644, "s3cret").display().to_string();
    let toml = "[mqtt]\nbroker = \"mqtt://127.0.0.1:1\"\nuser = \"cell\"\npassword_file = \"broker.password\"\n";
    let flags = Flags { config: Some(place.file("file.toml", 0o644, toml)), ..place.flags("sim://wsg50") };
    let findings = findings(&flags).await;
    let problem = |check: &str| findings.iter().find(|finding| finding.check == check).unwrap().text.clone();
    assert!(problem("secrets").contains(&path), "{findings:#?}");
    assert!(problem("mqtt").starts_with("mqtt://127.0.0.1:1: cannot connect"), "{findings:#?}");
}
