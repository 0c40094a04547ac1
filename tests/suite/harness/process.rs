//! A running process of the binary, with its output. The process ends with the test.

use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};

use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader};
use tokio::process::{ChildStderr, ChildStdout};
use tokio::sync::watch;

use super::child::{Child, Signal};
use super::eventually;

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

/// A process of the binary, killed on drop.
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
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let (child, stdout, stderr) = Child::start(&mut command);
        let stdout = Output::of(ChildStdout::from_std(stdout.unwrap()).unwrap());
        let stderr = Output::of(ChildStderr::from_std(stderr.unwrap()).unwrap());
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
        self.signal(Signal::TERM);
    }

    pub fn signal(&self, signal: Signal) {
        self.child.signal(signal);
    }

    pub fn kill(&self) {
        self.child.kill();
    }

    /// Waits for the exit.
    pub async fn ended(&mut self) -> Ended {
        let status = self.child.ended().await;
        Ended { status, stdout: self.stdout.all().await, stderr: self.stderr.all().await }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("--- standard error of process {} ---\n{}", self.child.id, self.stderr.text());
        }
    }
}
