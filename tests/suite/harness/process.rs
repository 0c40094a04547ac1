//! A running process of the binary, with its output. The process ends with the test.

use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex};

use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader};
use tokio::process::{Child, Command};
use tokio::sync::watch;

use super::{DEADLINE, eventually};

/// Lines that a process has printed so far.
#[derive(Debug)]
struct Output {
    lines: Arc<Mutex<Vec<String>>>,
    is_over: watch::Receiver<bool>,
}

impl Output {
    fn of(stream: impl AsyncRead + Unpin + Send + 'static) -> Self {
        let lines = Arc::new(Mutex::new(Vec::new()));
        let (over, is_over) = watch::channel(false);
        let kept = lines.clone();
        tokio::spawn(async move {
            let mut reader = BufReader::new(stream).lines();
            while let Ok(Some(line)) = reader.next_line().await {
                kept.lock().unwrap().push(line);
            }
            let _ = over.send(true);
        });
        Self { lines, is_over }
    }

    fn text(&self) -> String {
        self.lines.lock().unwrap().join("\n")
    }

    async fn all(&mut self) -> String {
        let _ = self.is_over.wait_for(|over| *over).await;
        self.text()
    }
}

/// Exit status and output of a process.
#[derive(Debug)]
pub struct Ended {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
}

pub fn signal(pid: u32, name: &str) {
    let sent =
        std::process::Command::new("sh").args(["-c", "kill -\"$1\" \"$2\"", "sh", name, &pid.to_string()]).status();
    assert!(sent.unwrap().success(), "SIG{name} to {pid}");
}

/// A process of the binary, killed by its own id on drop.
#[derive(Debug)]
pub struct Process {
    child: Child,
    stdout: Output,
    stderr: Output,
}

impl Process {
    /// Starts the binary with these arguments and without environment variables that configure it.
    pub fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wsg-gateway"));
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("WSG_GATEWAY")) {
            command.env_remove(name);
        }
        // No files stay behind, unless a test sets a path.
        command.env("WSG_GATEWAY_JOURNAL", ":memory:");
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
        let mut child = command.spawn().expect("the binary starts");
        let stdout = Output::of(child.stdout.take().unwrap());
        let stderr = Output::of(child.stderr.take().unwrap());
        Self { child, stdout, stderr }
    }

    /// Waits for a line that contains `before`, and returns the word after it.
    pub async fn word_after(&self, before: &str) -> String {
        eventually(&format!("{before:?} on standard output; standard error has {}", self.stderr.text()), async || {
            let text = self.stdout.text();
            let (_, rest) = text.split_once(before)?;
            rest.split_whitespace().next().map(str::to_owned)
        })
        .await
    }

    /// Standard error so far.
    pub fn log(&self) -> String {
        self.stderr.text()
    }

    /// Standard output so far.
    pub fn stdout(&self) -> String {
        self.stdout.text()
    }

    /// Number of lines on standard output so far.
    pub fn lines(&self) -> usize {
        self.stdout.lines.lock().unwrap().len()
    }

    /// Waits until standard error contains this text.
    pub async fn until_logged(&self, what: &str) {
        eventually(what, async || self.stderr.text().contains(what).then_some(())).await;
    }

    pub fn terminate(&self) {
        self.signal("TERM");
    }

    pub fn signal(&self, name: &str) {
        signal(self.child.id().expect("the process runs"), name);
    }

    pub fn kill(&mut self) {
        self.child.start_kill().expect("the process runs");
    }

    /// Waits for the exit.
    pub async fn ended(&mut self) -> Ended {
        let ended = tokio::time::timeout(DEADLINE, self.child.wait()).await;
        let status = ended.unwrap_or_else(|_| panic!("the process does not exit: {}", self.stderr.text())).unwrap();
        Ended { status, stdout: self.stdout.all().await, stderr: self.stderr.all().await }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("--- standard error of process {:?} ---\n{}", self.child.id(), self.stderr.text());
        }
    }
}
