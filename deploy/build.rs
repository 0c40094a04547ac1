//! Names the commit of the sources in the program, for `wsg-gateway --version`.

use std::env;
use std::path::Path;
use std::process::Command;

/// Variable with the commit. `deploy/package` sets it for container images, which are built without the repository.
const VARIABLE: &str = "WSG_GATEWAY_COMMIT";

/// Sources whose changes can make the program differ from its commit.
const SOURCES: [&str; 4] = ["src", "deploy", "Cargo.toml", "Cargo.lock"];

fn main() {
    println!("cargo::rerun-if-env-changed={VARIABLE}");
    println!("cargo::rerun-if-changed=deploy/build.rs");
    let given = env::var(VARIABLE).ok().filter(|commit| !commit.is_empty());
    let commit = match given {
        Some(commit) => commit,
        // With its commit, a debug build would compile everything again after each commit.
        None if env::var("PROFILE").as_deref() != Ok("release") => "unknown (debug build)".to_owned(),
        None => {
            rerun_if_changed();
            commit().unwrap_or_else(|| "unknown (built without git or its repository)".to_owned())
        }
    };
    println!("cargo::rustc-env={VARIABLE}={commit}");
}

/// Returns the commit that is checked out, marked if the sources differ from it.
#[must_use]
pub fn commit() -> Option<String> {
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    let is_same = git(&["diff", "--quiet", "HEAD"]).is_some();
    Some(if is_same { commit } else { format!("{commit}-changed") })
}

/// Lets the program be built again after a commit, a checkout or a change of the sources.
fn rerun_if_changed() {
    for source in SOURCES {
        println!("cargo::rerun-if-changed={source}");
    }
    for file in ["HEAD", "logs/HEAD"] {
        // Cargo takes a missing file as changed each time.
        if let Some(path) = git(&["rev-parse", "--git-path", file]).filter(|path| Path::new(path).exists()) {
            println!("cargo::rerun-if-changed={path}");
        }
    }
}

/// Returns what git prints about the sources; `None` if they are not in a repository of their own, or git fails.
fn git(arguments: &[&str]) -> Option<String> {
    let sources = env::var("CARGO_MANIFEST_DIR").ok().filter(|sources| Path::new(sources).join(".git").exists())?;
    // The sources can belong to another user, for example in a container.
    let is_safe = format!("safe.directory={sources}");
    let output = Command::new("git").args(["-C", &sources, "-c", &is_safe]).args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
