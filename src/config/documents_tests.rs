//! Documents of the configuration file: made anew from the declared settings, and compared with the checked-in files.
//! `WSG_TEST_WRITE=1 cargo test --lib documents` writes them.

use std::fmt::Write as _;
use std::path::Path;

use super::access::{AccessContent, ClientContent, TlsContent};
use super::mqtt::MqttContent;
use super::webhooks::WebhookContent;
use super::zenoh::ZenohContent;
use super::*;
use crate::settings::{Applied, DeclaredKey, SettingsGroup as _};

const GUIDE: &str = "deploy/guide/configuration.md";
const EXAMPLE: &str = "deploy/wsg-gateway.toml";
const HEADING: &str = "| key | default | range | meaning |\n| --- | --- | --- | --- |\n";

/// Beginning of the example file.
const PREAMBLE: &str = "\
# Configuration of the WSG gateway. Every key is listed with its default or an example. To change one, remove its `#`
# and that of the section heading above it. Then check the file with `wsg-gateway check --config FILE`, and restart the
# service.
#
# The reference is at http://127.0.0.1:8080/docs/guide/configuration. Without any gripper in this file, the gateway
# serves two simulated ones.
";

/// A client that has a certificate in place of an address.
const CLIENT_WITH_CERTIFICATE: &str = "
# A client with a certificate is known by its common name.
#[[clients]]
#name = \"mes\"
#certificate = \"mes.plant.example\"
#role = \"observer\"
";

/// The sections in the order of the example file, with their headings there.
fn sections() -> [(&'static str, &'static str, Vec<DeclaredKey>); 8] {
    [
        ("access", "[access]", AccessContent::keys()),
        ("clients", "[[clients]]", ClientContent::keys()),
        ("tls", "[tls]", TlsContent::keys()),
        ("drift", "[drift]", DriftContent::keys()),
        ("zenoh", "[zenoh]", ZenohContent::keys()),
        ("webhooks", "[[webhooks]]", WebhookContent::keys()),
        ("mqtt", "[mqtt]", MqttContent::keys()),
        ("grippers", "[grippers.left]", GripperContent::keys()),
    ]
}

/// The keys outside of sections.
fn top_keys() -> Vec<DeclaredKey> {
    Content::keys().into_iter().filter(|key| !is_section(key)).collect()
}

fn is_section(key: &DeclaredKey) -> bool {
    key.texts.range.is_empty()
}

fn read(file: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap()
}

fn compare(file: &str, made: &str) {
    if std::env::var_os("WSG_TEST_WRITE").is_some() {
        std::fs::write(Path::new(env!("CARGO_MANIFEST_DIR")).join(file), made).unwrap();
    }
    assert!(read(file) == made, "{file} is stale: WSG_TEST_WRITE=1 cargo test --lib documents");
}

fn words(doc: &str) -> impl Iterator<Item = &str> {
    doc.split_whitespace()
}

/// Row of a key in the guide's table.
fn row(key: &DeclaredKey) -> String {
    let DeclaredKey { key: name, doc, applied, texts, .. } = key;
    let restart = if *applied == Applied::Restart { " A new value takes effect after a restart." } else { "" };
    let meaning = words(doc).collect::<Vec<_>>().join(" ");
    format!("| `{name}` | {} | {} | {meaning}{restart} |\n", texts.default, texts.range)
}

/// A comment of the example file. Links have the address at which a gateway serves the guide.
fn comment(doc: &str) -> String {
    let mut plain = words(doc).collect::<Vec<_>>().join(" ");
    while let Some(start) = plain.find("](") {
        let open = plain[..start].rfind('[').unwrap();
        let end = start + plain[start..].find(')').unwrap();
        let url = plain[start + 2..end].replace(".md", "");
        let link = format!("{} (http://127.0.0.1:8080/docs/guide/{url})", &plain[open + 1..start]);
        plain.replace_range(open..=end, &link);
    }
    let mut lines = String::new();
    let mut line = "#".to_owned();
    for word in plain.split(' ') {
        if line.len() + 1 + word.len() > 120 {
            writeln!(lines, "{line}").unwrap();
            "#".clone_into(&mut line);
        }
        write!(line, " {word}").unwrap();
    }
    lines + &line + "\n"
}

fn examples(keys: &[DeclaredKey]) -> String {
    let shown = keys.iter().filter(|key| !key.texts.example.is_empty());
    shown
        .map(|key| format!("{}#{} = {}\n", comment(key.doc), key.key, key.texts.example))
        .collect::<Vec<_>>()
        .join("\n")
}

fn example_file() -> String {
    let mut made = format!("{PREAMBLE}\n{}", examples(&top_keys()));
    let all = Content::keys();
    assert_eq!(all.iter().filter(|key| is_section(key)).count(), sections().len(), "each section is in `sections`");
    for (name, heading, keys) in sections() {
        let doc = all.iter().find(|key| key.key == name).unwrap().doc;
        write!(made, "\n{}#{heading}\n{}", comment(doc), examples(&keys)).unwrap();
        if name == "clients" {
            made.push_str(CLIENT_WITH_CERTIFICATE);
        }
    }
    made
}

/// The example of the guide: the keys of the example file without those that need a file, or other clients. Its paths
/// do not depend on packages.
fn example_in_guide() -> String {
    let text = example_file().replace(CLIENT_WITH_CERTIFICATE, "").replace("/etc/wsg-gateway/", "");
    let text = text.replace("/var/lib/wsg-gateway/tokens", "tokens");
    let lines = text.lines().filter_map(|line| line.strip_prefix('#')).filter(|line| !line.starts_with(' '));
    let lines = lines.filter(|line| !line.is_empty() && !names_a_file(line));
    lines.map(|line| if line.starts_with('[') { format!("\n{line}\n") } else { format!("{line}\n") }).collect()
}

#[test]
fn example_file_is_current() {
    compare(EXAMPLE, &example_file());
}

#[test]
fn keys_in_the_guide_are_current() {
    let guide = read(GUIDE);
    let (before, rest) = guide.split_once("```toml\n").unwrap();
    let (_, rest) = rest.split_once("```\n").unwrap();
    let mut made = format!("{before}```toml\n{}```\n", example_in_guide());
    let (journal, top): (Vec<_>, Vec<_>) = top_keys().into_iter().partition(|key| key.key.contains("journal"));
    let tables = [top, journal].into_iter().chain(sections().map(|(_, _, keys)| keys));
    let mut parts = rest.split(HEADING);
    made.push_str(parts.next().unwrap());
    for keys in tables {
        let (_, after) = parts.next().expect("a table for each section").split_once("\n\n").unwrap();
        made.push_str(HEADING);
        for key in keys {
            made.push_str(&row(&key));
        }
        write!(made, "\n{after}").unwrap();
    }
    assert_eq!(parts.next(), None, "a section for each table");
    compare(GUIDE, &made);
}

/// Whether a line of the example file names a file, which has to exist. A user needs the file of the password.
pub(super) fn names_a_file(line: &str) -> bool {
    let is_path = line.split(" = ").next().is_some_and(|key| key.ends_with("_file"));
    is_path || line.starts_with("config = ") || line.starts_with("user = ")
}
