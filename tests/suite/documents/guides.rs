//! The guides: complete, linked correctly, and served by the gateway.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use comrak::nodes::NodeValue;
use comrak::{Anchorizer, Arena, Options};
use proc_macro2::{TokenStream, TokenTree};
use reqwest::Url;
use serde_json::Value;
use syn::LitStr;
use walkdir::WalkDir;

use crate::harness::{Gateway, Simulator, run};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap()
}

/// The guides, and the README files that link to them.
fn documents() -> Vec<PathBuf> {
    let guides = fs::read_dir(root().join("deploy/guide")).unwrap().map(|entry| entry.unwrap().path());
    let others = ["README.md", "src/README.md", "tests/README.md", "deploy/device/README.md", "deploy/zenoh/README.md"];
    let others = others.map(|path| root().join(path));
    guides.filter(|path| path.extension().is_some_and(|extension| extension == "md")).chain(others).collect()
}

/// Further texts for people who change the code. They may name more than a user can set or see.
fn developer_documents() -> [PathBuf; 3] {
    ["src/design.md", "src/rulings.md", "tests/measurements.md"].map(|path| root().join(path))
}

/// The links and the anchors of a document.
fn links_and_anchors(markdown: &str) -> (Vec<String>, BTreeSet<String>) {
    let (arena, mut options, mut anchorizer) = (Arena::new(), Options::default(), Anchorizer::new());
    options.extension.table = true;
    let (mut links, mut anchors) = (Vec::new(), BTreeSet::new());
    for node in comrak::parse_document(&arena, markdown, &options).descendants() {
        match &node.data.borrow().value {
            NodeValue::Link(link) | NodeValue::Image(link) => links.push(link.url.clone()),
            NodeValue::Heading(_) => {
                let text: String = node.descendants().filter_map(|node| text(&node.data.borrow().value)).collect();
                anchors.insert(anchorizer.anchorize(&text));
            }
            _ => {}
        }
    }
    (links, anchors)
}

fn text(value: &NodeValue) -> Option<String> {
    match value {
        NodeValue::Text(text) => Some(text.to_string()),
        NodeValue::Code(code) => Some(code.literal.clone()),
        _ => None,
    }
}

#[tokio::test]
async fn links_lead_to_files_and_anchors() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::of(device.address).await;
    let read: BTreeMap<_, _> = documents()
        .into_iter()
        .chain(developer_documents())
        .map(|path| (path.canonicalize().unwrap(), links_and_anchors(&fs::read_to_string(&path).unwrap())))
        .collect();
    let mut wrong = Vec::new();
    for (path, (links, anchors)) in &read {
        for link in links.iter().filter(|link| !link.contains("://") && !link.starts_with("mailto:")) {
            let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
            let is_right = if target.starts_with('/') {
                gateway.get(target).await.status == 200
            } else if target.is_empty() {
                anchors.contains(anchor)
            } else {
                path.parent().unwrap().join(target).canonicalize().is_ok_and(|target| {
                    anchor.is_empty() || read.get(&target).is_some_and(|(_, anchors)| anchors.contains(anchor))
                })
            };
            if !is_right {
                wrong.push(format!("{}: {link}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The values of an attribute in a page.
fn values<'a>(page: &'a str, attribute: &str) -> Vec<&'a str> {
    let begin = format!("{attribute}=\"");
    let after_first = page.split_once(&begin).into_iter();
    after_first.flat_map(|(_, rest)| rest.split(&begin)).filter_map(|rest| rest.split('"').next()).collect()
}

/// The path of a link's target, or `None` if the target is on another host.
fn linked_path(page: &str, link: &str) -> Option<String> {
    let gateway = Url::parse("http://gateway").unwrap();
    let target = gateway.join(page).unwrap().join(link).unwrap();
    (target.origin() == gateway.origin()).then(|| target.path().to_owned())
}

#[tokio::test]
async fn guides_are_served_with_their_links() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::of(device.address).await;
    let mut pages = BTreeMap::new();
    let mut open = vec!["/docs/guide/".to_owned()];
    while let Some(path) = open.pop() {
        if pages.contains_key(&path) {
            continue;
        }
        let answer = gateway.get(&path).await;
        assert_eq!(answer.status, 200, "{path}");
        let page = answer.body.as_str().unwrap_or_default().to_owned();
        let links = values(&page, "href");
        assert!(links.iter().all(|link| !link.starts_with('/')), "{path}: a proxy can serve guides below a path");
        let links = links.into_iter().filter_map(|link| linked_path(&path, link));
        open.extend(links.filter(|link| link.starts_with("/docs/")));
        pages.insert(path, page);
    }
    for (path, page) in &pages {
        for link in values(page, "href") {
            let anchor = link.split_once('#').map_or("", |(_, anchor)| anchor);
            let Some(linked) = linked_path(path, link).and_then(|target| pages.get(&target)) else { continue };
            assert!(anchor.is_empty() || values(linked, "id").contains(&anchor), "{path}: {link}");
        }
    }
    for alias in ["/docs/guide", "/docs/guide/README.md"] {
        assert_eq!(gateway.get(alias).await.body.as_str().unwrap(), pages["/docs/guide/"], "{alias}");
    }
    let served: BTreeSet<_> = pages.keys().filter_map(|path| path.strip_prefix("/docs/guide/")).collect();
    for file in fs::read_dir(root().join("deploy/guide")).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap().replace(".md", "");
        assert!(name == "README" || served.contains(name.as_str()), "no page links to {name}");
    }
}

/// The names of the configuration file's keys and sections. A test of the library makes the example file from their
/// declarations.
fn configuration_keys() -> BTreeSet<String> {
    let example = read("deploy/wsg-gateway.toml");
    let lines = example.lines().filter_map(|line| line.strip_prefix('#'));
    let keys = lines.clone().filter_map(|line| line.split_once(" = ")).map(|(key, _)| key);
    let sections = lines.filter(|line| line.starts_with('[')).map(|line| line.trim_matches(['[', ']']));
    let sections = sections.filter_map(|name| name.split('.').next());
    keys.chain(sections).filter(|key| !key.contains(' ')).map(str::to_owned).collect()
}

/// The flags and variables of the command line.
async fn flags() -> BTreeSet<String> {
    let mut words = BTreeSet::new();
    for command in ["", "sim", "decode", "doctor", "discover", "journal list"] {
        let arguments: Vec<_> = command.split_whitespace().chain(["--help"]).collect();
        let help = run(&arguments).await.stdout;
        let is_part = |character: char| character.is_ascii_alphanumeric() || matches!(character, '-' | '_');
        words.extend(help.split(|character| !is_part(character)).map(str::to_owned));
    }
    words.retain(|word| {
        word.starts_with("WSG_GATEWAY_") || word.strip_prefix("--").is_some_and(|word| !word.is_empty())
    });
    words
}

fn values_of(schema: &str) -> BTreeSet<String> {
    let document: Value = serde_json::from_str(&read("openapi/openapi.json")).unwrap();
    let values = document["components"]["schemas"][schema]["enum"].as_array().unwrap();
    values.iter().map(|value| value.as_str().unwrap().to_owned()).collect()
}

async fn metrics() -> BTreeSet<String> {
    let gateway = Gateway::with_webhook(&["--gripper", "g=sim://wsg50"]).await;
    gateway.post("fast-stop", &Value::default()).await.ok();
    let text = gateway.get("/metrics").await.ok();
    let help = text.as_str().unwrap().lines().filter_map(|line| line.strip_prefix("# HELP "));
    help.filter_map(|line| line.split(' ').next()).filter(|name| name.starts_with("wsg_")).map(str::to_owned).collect()
}

fn alerts() -> BTreeSet<String> {
    let text = read("deploy/prometheus/alerts.yml");
    text.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).map(str::to_owned).collect()
}

#[tokio::test]
async fn guides_name_all_that_a_user_can_set_or_see() {
    let guides: String = documents().iter().map(|path| fs::read_to_string(path).unwrap()).collect();
    for (kind, names) in [
        ("configuration key", configuration_keys()),
        ("flag or variable", flags().await),
        ("metric", metrics().await),
        ("alert", alerts()),
        ("kind of event", values_of("EventKind")),
        ("problem code", values_of("Code")),
        ("outcome", values_of("Outcome")),
    ] {
        assert!(names.len() > 3, "{kind}: {names:?}");
        let is_code = |name: &&String| {
            ["`", "\"", " "].iter().any(|end| guides.contains(&format!("`{name}{end}")))
                || guides.contains(&format!("{name} = "))
        };
        let missing: Vec<_> = names.iter().filter(|name| !is_code(name)).collect();
        assert!(missing.is_empty(), "no guide names {kind} {missing:?}");
    }
}

/// Words of other programs, of this one's URLs and registers, and metrics that the gateway here lacks, which the guides
/// show as code.
const OTHER_WORDS: &[&str] = &[
    "autosave_on_changes",
    "bound_to",
    "checksum_evaluation",
    "clean_start",
    "command_out_type",
    "connect_certificate",
    "connect_private_key",
    "contact_width",
    "control_msgs",
    "declare_queryable",
    "enable_mtls",
    "expired_at",
    "extra_headers",
    "fast_stop_number",
    "forward_position_controller",
    "gripper_addr",
    "gripper_port",
    "liveliness_token",
    "lost_after_ms",
    "lz4_flex",
    "mosquitto_pub",
    "mosquitto_sub",
    "motion_number",
    "on_loss",
    "peak_force",
    "process_cpu_seconds_total",
    "process_max_fds",
    "process_open_fds",
    "process_resident_memory_bytes",
    "process_start_time_seconds",
    "process_threads",
    "process_virtual_memory_bytes",
    "root_ca_certificate",
    "schunk_driver",
    "schunk_wsg_driver",
    "wsg50_cpp",
    "wsg_certificate_expiry_timestamp_seconds",
    "wsg_gateway",
    "wsg_journal_bytes",
    "wsg_lease_holder_info",
    "wsg_port_refused_total",
    "wsg_token_expiry_timestamp_seconds",
];

/// Folders that define the options of simulated grippers and of addresses, and the names of the Python package and of the
/// node for ROS 2.
const OPTIONS: &[&str] = &["src/sim", "src/daemon/simulation", "src/transport", "deploy/python", "deploy/ros2"];

/// The words of a text that are written like keys, e.g. `max_hz`.
fn key_like(text: &str) -> BTreeSet<&str> {
    let words = text
        .split(|character: char| !character.is_ascii_lowercase() && !character.is_ascii_digit() && character != '_');
    words.filter(|word| word.trim_matches('_').contains('_')).collect()
}

/// The words of a text that begin with a capital, as the API writes them: `place_part` for `PlacePart`.
fn snake_case(text: &str) -> String {
    let mut words = String::new();
    for character in text.chars() {
        match character {
            'A'..='Z' => words.extend(['_', character.to_ascii_lowercase()]),
            'a'..='z' | '0'..='9' => words.push(character),
            _ => words.push(' '),
        }
    }
    words.replace(" _", " ")
}

/// The code and the TOML blocks of a document.
fn code_of(markdown: &str) -> (Vec<String>, Vec<String>) {
    let (arena, mut options) = (Arena::new(), Options::default());
    options.extension.table = true;
    let (mut code, mut toml) = (Vec::new(), Vec::new());
    for node in comrak::parse_document(&arena, markdown, &options).descendants() {
        match &node.data.borrow().value {
            NodeValue::Code(inline) => code.push(inline.literal.clone()),
            NodeValue::CodeBlock(block) if block.info == "toml" => toml.push(block.literal.clone()),
            _ => {}
        }
    }
    (code, toml)
}

/// The keys of a TOML table and of those within it. Names of grippers are left out.
fn keys_of(table: &toml::Table, found: &mut BTreeSet<String>) {
    for (key, value) in table {
        found.insert(key.clone());
        let inner: Vec<_> = match value {
            toml::Value::Table(grippers) if key == "grippers" => grippers.values().collect(),
            toml::Value::Table(_) => vec![value],
            toml::Value::Array(items) => items.iter().collect(),
            _ => vec![],
        };
        inner.into_iter().filter_map(toml::Value::as_table).for_each(|inner| keys_of(inner, found));
    }
}

#[tokio::test]
async fn guides_name_no_key_that_does_not_exist() {
    let keys = configuration_keys();
    let options: String = OPTIONS
        .iter()
        .flat_map(|folder| WalkDir::new(root().join(folder)))
        .fold(String::new(), |text, entry| text + &fs::read_to_string(entry.unwrap().path()).unwrap_or_default());
    let contract = read("openapi/openapi.json") + &read("openapi/asyncapi.yaml");
    let metrics = metrics().await;
    let variants = snake_case(&options);
    let mut known: BTreeSet<&str> = [&*options, &*variants, &*contract].into_iter().flat_map(key_like).collect();
    known.extend(keys.iter().chain(&metrics).map(String::as_str));
    let others: BTreeSet<_> = OTHER_WORDS.iter().copied().collect();
    let (mut wrong, mut used) = (BTreeSet::new(), BTreeSet::new());
    for path in
        documents().into_iter().filter(|path| !path.ends_with("src/README.md") && !path.ends_with("tests/README.md"))
    {
        let (code, toml) = code_of(&fs::read_to_string(&path).unwrap());
        for word in code.iter().flat_map(|code| key_like(code)) {
            used.extend(others.get(word));
            if !known.contains(word) && !others.contains(word) {
                wrong.insert(format!("{}: {word}", path.display()));
            }
        }
        for block in toml {
            let mut found = BTreeSet::new();
            keys_of(
                &block.parse::<toml::Table>().unwrap_or_else(|error| panic!("{}: {error}\n{block}", path.display())),
                &mut found,
            );
            wrong.extend(found.difference(&keys).map(|key| format!("{}: {key}", path.display())));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    let unused: Vec<_> = others.difference(&used).collect();
    assert!(unused.is_empty(), "no guide has these words any more: {unused:?}");
}

/// The texts of the warnings and errors that this code logs.
fn log_messages(code: TokenStream) -> Vec<String> {
    let tokens: Vec<_> = code.into_iter().collect();
    let mut messages = Vec::new();
    for (index, token) in tokens.iter().enumerate() {
        let TokenTree::Group(group) = token else { continue };
        if let [.., TokenTree::Ident(name), TokenTree::Punct(mark)] = &tokens[..index]
            && mark.as_char() == '!'
            && (name == "warn" || name == "error")
        {
            let literals = group.stream().into_iter().filter_map(|token| syn::parse2::<LitStr>(token.into()).ok());
            messages.extend(literals.last().map(|text| text.value()));
        }
        messages.extend(log_messages(group.stream()));
    }
    messages
}

#[test]
fn warnings_and_errors_of_the_log_are_explained() {
    let guide = read("deploy/guide/operation.md");
    let code = WalkDir::new(root().join("src")).into_iter().map(|entry| entry.unwrap().into_path());
    let messages: BTreeSet<_> = code
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .flat_map(|path| log_messages(fs::read_to_string(path).unwrap().parse().unwrap()))
        .collect();
    assert!(messages.len() > 80, "{messages:?}");
    // Texts between the values that a message contains.
    let explained =
        |message: &String| format!("`{message}`").split(['{', '}']).step_by(2).all(|part| guide.contains(part));
    let missing: Vec<_> = messages.iter().filter(|message| !explained(message)).collect();
    assert!(missing.is_empty(), "not in operation.md: {missing:#?}");
}
