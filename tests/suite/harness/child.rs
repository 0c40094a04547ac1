//! A child process that a dedicated thread reaps.
//!
//! The kernel can take half a minute to reap a process. Tokio reaps the children that nobody waits for on a worker of
//! any runtime, even one of Zenoh's, which meanwhile serves no socket and no timer.

use std::os::fd::OwnedFd;
use std::process::{Command, ExitStatus};

use rustix::process::{Pid, PidfdFlags, pidfd_open, pidfd_send_signal};
use tokio::sync::watch;
use tokio::time::timeout;

use super::DEADLINE;

pub use rustix::process::Signal;

/// A process, killed on drop.
#[derive(Debug)]
pub struct Child {
    pub id: u32,
    handle: OwnedFd,
    status: watch::Receiver<Option<ExitStatus>>,
}

impl Child {
    /// Starts a process. Its piped streams are returned as well.
    pub fn start(
        command: &mut Command,
    ) -> (Self, Option<std::process::ChildStdout>, Option<std::process::ChildStderr>) {
        let program = command.get_program().to_owned();
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{} does not start: {error}", program.display()));
        let (stdout, stderr, id) = (child.stdout.take(), child.stderr.take(), child.id());
        let pid = Pid::from_raw(id.try_into().unwrap()).unwrap();
        let handle = pidfd_open(pid, PidfdFlags::empty()).unwrap();
        let (ended, status) = watch::channel(None);
        std::thread::spawn(move || ended.send(Some(child.wait().unwrap())));
        (Self { id, handle, status }, stdout, stderr)
    }

    pub fn signal(&self, signal: Signal) {
        pidfd_send_signal(&self.handle, signal).expect("the process runs");
    }

    pub fn kill(&self) {
        self.signal(Signal::KILL);
    }

    /// Waits for the exit.
    pub async fn ended(&mut self) -> ExitStatus {
        let ended = timeout(DEADLINE, self.status.wait_for(Option::is_some)).await.expect("the process exits");
        ended.expect("the thread waits for the process").unwrap()
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // The process may have exited already.
        let _ = pidfd_send_signal(&self.handle, Signal::KILL);
    }
}
