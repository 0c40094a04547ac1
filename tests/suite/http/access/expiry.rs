//! Tokens that end: announced before, and named when they are refused.

use serde_json::{Value, json};

use crate::harness::{Directory, Gateway, eventually, run};

/// A file of tokens whose times a test can change.
struct TokenFile {
    directory: Directory,
    path: String,
}

impl TokenFile {
    fn new() -> Self {
        let directory = Directory::new();
        let path = directory.file("tokens.json");
        Self { directory, path }
    }

    /// Creates a token that was created 80 days ago, and ends in this number of days. Returns its secret.
    async fn create(&self, name: &str, role: &str, days_left: Option<i64>) -> String {
        let created = run(&["token", "--tokens", &self.path, "create", "--name", name, "--role", role]).await;
        assert!(created.status.success(), "{created:?}");
        let mut content: Value = serde_json::from_str(&std::fs::read_to_string(&self.path).unwrap()).unwrap();
        let token = content["tokens"].as_array_mut().unwrap().last_mut().unwrap().as_object_mut().unwrap();
        let day = |days: i64| json!((jiff::Timestamp::now() + jiff::SignedDuration::from_hours(days * 24)).to_string());
        token.insert("created_at".to_owned(), day(-80));
        match days_left {
            Some(days) => token.insert("expires_at".to_owned(), day(days)),
            None => token.remove("expires_at"),
        };
        std::fs::write(&self.path, content.to_string()).unwrap();
        created.stdout.trim().to_owned()
    }
}

#[tokio::test]
async fn ending_token_is_an_alarm_a_metric_and_a_log_line() {
    let tokens = TokenFile::new();
    let boss = tokens.create("boss", "supervisor", None).await;
    tokens.create("plc7", "operator", Some(5)).await;
    tokens.create("mes", "observer", Some(20)).await;
    let old = tokens.create("old", "operator", Some(-1)).await;
    let gateway = Gateway::start(&["--tokens", &tokens.path, "--gripper", "g=sim://wsg50"]).await;
    let get = async |path: &str, token: &str| {
        gateway.send(gateway.request("GET", path).header("Authorization", format!("Bearer {token}"))).await
    };
    let ending = async || -> Vec<Value> {
        let listed = get("/api/v1/alarms", &boss).await.ok();
        listed["alarms"].as_array().unwrap().iter().filter(|one| one["alarm"] == "token_expiring").cloned().collect()
    };
    let alarms = eventually("two alarms", async || Some(ending().await).filter(|alarms| alarms.len() == 2)).await;
    assert_eq!([&alarms[0]["name"], &alarms[1]["name"]], [&json!("old"), &json!("plc7")]);
    assert!(alarms[0]["cause"].as_str().unwrap().starts_with("expired on "), "{}", alarms[0]);
    assert!(alarms[1]["cause"].as_str().unwrap().contains("create another token, give it to the client"));

    let metrics = get("/metrics", &boss).await.ok();
    let metrics = metrics.as_str().unwrap();
    let series = "wsg_token_expiry_timestamp_seconds{token=\"plc7\"} ";
    let expires_at: i64 = metrics.split(series).nth(1).unwrap().lines().next().unwrap().parse().unwrap();
    let days_left = (expires_at - jiff::Timestamp::now().as_second()) as f64 / 86_400.0;
    assert!((4.9..5.1).contains(&days_left), "{days_left}");
    assert!(!metrics.contains("token=\"boss\""), "a token without an end has no time");

    for _ in 0..3 {
        get("/api/v1/me", &old).await.problem(401, "unauthorized");
    }
    for name in ["old", "plc7"] {
        let revoked = run(&["token", "--tokens", &tokens.path, "revoke", name]).await;
        assert!(revoked.status.success(), "{revoked:?}");
    }
    eventually("the alarms end", async || {
        ending().await.iter().all(|alarm| !alarm["ended_at"].is_null()).then_some(())
    })
    .await;
    let log = gateway.terminate().await.stderr;
    let lines: Vec<_> = log.lines().filter(|line| line.contains("expired token refused")).collect();
    assert!(lines.len() == 1 && lines[0].contains("old"), "{lines:#?}");
    drop(tokens.directory);
}

#[tokio::test]
async fn new_token_says_when_it_ends() {
    let tokens = TokenFile::new();
    let create = async |more: &[&str]| {
        let own = ["token", "--tokens", &tokens.path, "create", "--role", "operator"];
        run(&[&own[..], more].concat()).await
    };
    let default = create(&["--name", "plc7"]).await;
    assert!(default.stdout.trim().starts_with("wsg_") && default.stdout.trim().lines().count() == 1, "{default:?}");
    assert!(default.stderr.starts_with("token plc7 expires on 2"), "{default:?}");
    assert!(default.stderr.contains("revoke plc7, and create it again with --expires never"), "{default:?}");
    let never = create(&["--name", "plc8", "--expires", "never"]).await;
    assert_eq!(never.stderr.trim(), "token plc8 does not expire");
    let pin = create(&["--name", "anna", "--pin"]).await;
    assert!(pin.stderr.starts_with("PIN anna expires on 2") && pin.stdout.trim().len() == 6, "{pin:?}");
}
