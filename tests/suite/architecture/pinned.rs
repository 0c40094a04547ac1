//! Pinned parts of the workflows: nobody can replace what they run without a change of this repository.

use std::fs;
use std::path::Path;

use walkdir::WalkDir;

/// The lines of all workflows, with the name of the file.
fn lines_of_workflows() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(".github/workflows");
    let files = WalkDir::new(folder).into_iter().map(Result::unwrap).filter(|entry| entry.file_type().is_file());
    let mut lines = Vec::new();
    for file in files {
        let name = file.file_name().to_string_lossy().into_owned();
        let text = fs::read_to_string(file.path()).unwrap();
        lines.extend(text.lines().map(|line| (name.clone(), line.trim().to_owned())));
    }
    lines
}

/// Whether the line runs code of others that is not fixed by a commit, a version or a hash.
fn is_open(line: &str) -> bool {
    if let Some((_, action)) = line.split_once("uses: ") {
        let commit = action.split_once('@').map(|(_, rest)| rest.split(' ').next().unwrap_or_default());
        let is_commit =
            commit.is_some_and(|commit| commit.len() == 40 && commit.chars().all(|c| c.is_ascii_hexdigit()));
        return !action.starts_with("./") && !is_commit;
    }
    if let Some((_, tools)) = line.split_once("cargo install ") {
        return tools.split_whitespace().any(|tool| !tool.starts_with("--") && !tool.contains('@'));
    }
    line.contains("pip install") && !line.contains("--require-hashes")
}

#[test]
fn workflows_run_only_what_is_pinned() {
    for open in ["- uses: actions/checkout@v4", "- run: cargo install --locked cargo-deb", "- run: pip install ziglang"]
    {
        assert!(is_open(open), "{open}");
    }
    let lines = lines_of_workflows();
    assert!(lines.iter().any(|(_, line)| line.contains("uses: actions/")), "no workflow found");
    let open: Vec<_> = lines.iter().filter(|(_, line)| is_open(line)).collect();
    assert!(open.is_empty(), "not pinned: {open:#?}");
}

/// A job that builds or tests runs code of many others, so it gets no token that can write.
#[test]
fn job_with_a_token_that_can_write_runs_no_build() {
    let release =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(".github/workflows/release.yml")).unwrap();
    let (before, publish) = release.split_once("\n  publish:\n").unwrap();
    assert!(!before.contains("contents: write") && !before.contains("github.token"), "{before}");
    for command in ["cargo", "pip", "deploy/", "actions/checkout"] {
        assert!(!publish.contains(command), "the job with the token runs {command}");
    }
}
