//! Backups of a whole gateway, and what a restored one knows of the time after them.

use serde_json::{Value, json};

use crate::harness::{Directory, Gateway, Simulator, eventually, run};

const CONFIG: &str = "journal_max_size_mb = 64\n[access]\ntokens = \"tokens.json\"\n";

/// A gateway with files of its own, besides the device.
struct Installation {
    files: Directory,
    device: Simulator,
    token: String,
}

impl Installation {
    async fn new() -> Self {
        let files = Directory::new();
        files.write("wsg-gateway.toml", CONFIG);
        let tokens = files.file("tokens.json");
        let created = run(&["token", "--tokens", &tokens, "create", "--name", "cell", "--role", "supervisor"]).await;
        assert!(created.status.success(), "{created:?}");
        let token = created.stdout.trim().to_owned();
        Self { files, device: Simulator::start(&[]).await, token }
    }

    fn journal(&self) -> String {
        self.files.file("state/gateway.db")
    }

    fn config(&self) -> String {
        self.files.file("wsg-gateway.toml")
    }

    async fn start(&self) -> Gateway {
        let gripper = format!("g=tcp://{}", self.device.address);
        let own = ["--gripper", &gripper, "--config", &self.config(), "--journal", &self.journal()];
        let gateway = Gateway::start(&own).await.with_token(&self.token);
        gateway.until_link("connected").await;
        gateway
    }

    async fn back_up(&self, to: &str) -> crate::harness::Ended {
        run(&["backup", "--config", &self.config(), "--journal", &self.journal(), to]).await
    }
}

fn move_to(width_mm: u32, request_id: &str) -> Value {
    json!({"width_mm": width_mm, "speed_mm_s": 300, "request_id": request_id})
}

/// Takes the lease and gives it back. Returns its epoch.
async fn lease_epoch(gateway: &Gateway) -> u64 {
    let lease = gateway.post("lease", &json!({"holder": "plc-1"})).await.ok();
    let token = lease["token"].as_str().unwrap().to_owned();
    gateway.send(gateway.request("DELETE", "lease").header("Wsg-Lease", token)).await.ok();
    lease["epoch"].as_u64().unwrap()
}

#[tokio::test]
async fn blank_machine_is_restored_from_one_file_and_nothing_moves_twice() {
    let installation = Installation::new().await;
    let gateway = installation.start().await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let recipe = json!({"number": 7, "width_mm": 20, "speed_mm_s": 50, "force_n": 30});
    assert_eq!(gateway.put("/api/v1/recipes/ring", &recipe).await.status, 201);
    gateway.post("move", &move_to(60, "before")).await.outcome("SUCCESS");
    lease_epoch(&gateway).await;

    // The backup runs beside motions.
    let away = Directory::new();
    let backup = away.file("gateway.tar");
    let motions = async {
        for number in 0..10 {
            gateway.post("move", &move_to(50 + number % 2, &format!("beside-{number}"))).await.outcome("SUCCESS");
        }
    };
    let (saved, ()) = tokio::join!(installation.back_up(&backup), motions);
    assert!(saved.status.success(), "{saved:?}");
    assert!(saved.stdout.contains("tokens.json") && saved.stdout.contains("gateway.db"), "{}", saved.stdout);
    let mode = std::os::unix::fs::PermissionsExt::mode(&std::fs::metadata(&backup).unwrap().permissions());
    assert_eq!(mode & 0o777, 0o600);
    assert!(installation.back_up(&backup).await.stderr.contains("exists: name a new file"));

    gateway.post("move", &move_to(80, "after")).await.outcome("SUCCESS");
    let newest_epoch = lease_epoch(&gateway).await;
    gateway.terminate().await;
    let refused = run(&["restore", &backup]).await;
    assert!(refused.stderr.contains("so nothing was restored"), "{refused:?}");
    for name in ["wsg-gateway.toml", "tokens.json"] {
        std::fs::remove_file(installation.files.file(name)).unwrap();
    }
    std::fs::remove_dir_all(installation.files.file("state")).unwrap();
    let restored = run(&["restore", &backup]).await;
    assert!(restored.status.success(), "{restored:?}");

    let gateway = installation.start().await;
    let recipe = gateway.get("/api/v1/recipes/ring").await.ok();
    assert_eq!(recipe["number"], 7);
    let history = gateway.get("/api/v1/events?kind=command&order=oldest").await.ok();
    assert_eq!(history["events"][0]["command"], "home");
    assert!(lease_epoch(&gateway).await > newest_epoch);

    // The gripper was moved by a request of which the journal knows nothing.
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let width = gateway.until_standing().await["width_mm"].clone();
    gateway.post("move", &move_to(80, "after")).await.problem(409, "unknown_past");
    assert_eq!(gateway.post("move", &move_to(60, "before")).await.ok()["replayed"], true);
    assert_eq!(gateway.until_standing().await["width_mm"], width);
    gateway.post("move", &json!({"width_mm": 70, "speed_mm_s": 300})).await.outcome("SUCCESS");
    let readiness = gateway.get("/readyz").await;
    assert_eq!(readiness.status, 503);
    assert!(readiness.text("journal_restored").contains("does not continue"), "{}", readiness.body);

    // A person looks, and acknowledges.
    let alarms = gateway.get("/api/v1/alarms").await.ok();
    let mut listed = alarms["alarms"].as_array().unwrap().iter();
    let alarm = listed.find(|alarm| alarm["alarm"] == "journal_restored").unwrap();
    gateway.post("/api/v1/alarms/acknowledge", &json!({"ids": [alarm["id"]]})).await.ok();
    eventually("readiness", async || ready(&gateway).await).await;
    gateway.post("move", &move_to(80, "after")).await.outcome("SUCCESS");
    gateway.terminate().await;
}

async fn ready(gateway: &Gateway) -> Option<()> {
    (gateway.get("/readyz").await.status == 200).then_some(())
}

#[tokio::test]
async fn backup_of_another_journal_than_the_running_one_says_so() {
    let files = Directory::new();
    let journal = files.file("own.db");
    let gateway = Gateway::start(&["--gripper", "g=sim://wsg50", "--journal", &journal]).await;
    let saved = run(&["journal", "backup", "--journal", &journal, &files.file("1.db")]).await;
    assert!(saved.stdout.contains(&format!("from {journal} (a gateway is writing to it)")), "{saved:?}");
    gateway.terminate().await;
    let saved = run(&["journal", "backup", "--journal", &journal, &files.file("2.db")]).await;
    assert!(saved.stdout.contains("no gateway uses it now; if yours runs with --journal"), "{saved:?}");
}

#[tokio::test]
async fn backup_has_each_file_once_and_names_the_missing_ones() {
    let files = Directory::new();
    std::fs::create_dir(files.file("access")).unwrap();
    files.write("mes.secret", "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw");
    let hook = |name| {
        format!("[[webhooks]]\nname = \"{name}\"\nurl = \"http://127.0.0.1:9/\"\nsecret_file = \"mes.secret\"\n")
    };
    let rights = "[access]\ntokens = \"access/../tokens.json\"\n";
    let config = files
        .write("gateway.toml", &format!("{rights}{}{}[grippers.g]\nurl = \"sim://wsg50\"\n", hook("a"), hook("b")));
    let backup = files.file("gateway.tar");
    let saved = async || run(&["backup", "--config", &config, "--journal", ":memory:", &backup]).await;
    let first = saved().await;
    assert!(first.stdout.contains("tokens.json: it does not exist"), "{first:?}");
    std::fs::remove_file(&backup).unwrap();
    let created =
        run(&["token", "--config", &config, "create", "--name", "a", "--role", "stop", "--expires", "never"]).await;
    assert!(created.status.success(), "{created:?}");
    let second = saved().await;
    assert_eq!(second.stdout.matches("mes.secret").count(), 1, "{second:?}");
    let blank = Directory::new();
    let restored = run(&["restore", &backup, "--root", blank.path()]).await;
    assert!(restored.status.success(), "{restored:?}");
    for name in ["gateway.toml", "mes.secret", "tokens.json"] {
        let place = std::fs::canonicalize(files.file(name)).unwrap();
        let there = std::path::Path::new(blank.path()).join(place.strip_prefix("/").unwrap());
        assert_eq!(std::fs::read(there).unwrap(), std::fs::read(place).unwrap(), "{name}");
    }
}

#[tokio::test]
async fn file_that_is_no_backup_is_refused_and_paths_lead_nowhere_else() {
    let files = Directory::new();
    let text = files.write("text.tar", "no archive");
    assert!(run(&["restore", &text]).await.stderr.contains("is not a backup of a gateway"));
    let mut archive = tar::Builder::new(std::fs::File::create(files.file("evil.tar")).unwrap());
    let manifest = json!({"format": 1, "gateway": "g", "version": "1", "at": "2026-11-29T00:00:00Z"}).to_string();
    for (path, content) in [("wsg-gateway-backup.json", manifest.as_str()), ("a/../../../outside", "evil")] {
        let mut header = tar::Header::new_gnu();
        header.as_gnu_mut().unwrap().name[..path.len()].copy_from_slice(path.as_bytes());
        header.set_size(content.len() as u64);
        header.set_mode(0o600);
        header.set_cksum();
        archive.append(&header, content.as_bytes()).unwrap();
    }
    archive.into_inner().unwrap();
    let root = files.file("root");
    let refused = run(&["restore", "--root", &root, &files.file("evil.tar")]).await;
    assert!(refused.stderr.contains("is not a path of a backup"), "{refused:?}");
    assert!(!std::path::Path::new(&root).exists());
}
