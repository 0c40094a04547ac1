//! The device's end of a serial line: a pty. Its bytes are paced here, since a pty itself has no speed.

use std::fs;
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::{Errno, ioctl_fionread, read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, ioctl_tiocnxcl, tcflush, tcgetattr, tcsetattr};
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Interval, interval};
use url::Url;

use crate::transport::{Options, Pacer, Pipe, SerialAddress};

const DEFAULT_BAUD: u32 = 115_200;

pub(super) const OPTIONS: [&str; 2] = ["baud", "link"];

/// Directory of ptys.
const PTYS: &str = "/dev/pts";

/// Number of unread bytes from which the port may be closed.
const MANY_UNREAD_BYTES: u64 = 2048;

/// Time after which so many unread bytes are discarded, as a real port loses what comes while it is closed. Even on a
/// busy machine, a reader or the kernel's worker is late by less than this.
const DISCARDED_AFTER: Duration = Duration::from_millis(500);

/// Interval of lifting exclusive access to the port, which a killed client leaves in place.
const FREE_EVERY: Duration = Duration::from_millis(500);

/// Source of ptys, one at a time. An adapter that is pulled and comes back is another pty under the same link.
pub(super) struct PtySource {
    baud: u32,
    link: Option<PathBuf>,
    /// The pty for the next client.
    next: Option<Pty>,
    /// Name of the newest pty.
    name: String,
}

impl PtySource {
    /// Opens a pty as in `serial://pty?baud=115200&link=/tmp/gripper`.
    pub(super) fn new(url: &Url) -> anyhow::Result<Self> {
        ensure!(url.host_str() == Some("pty"), "a simulated device can only be on a pty: write serial://pty");
        let options = Options::of(url, &OPTIONS).map_err(anyhow::Error::msg)?;
        let baud = options.number("baud", 1200..=460_800).map_err(anyhow::Error::msg)?.unwrap_or(DEFAULT_BAUD);
        let link = options.text("link").map(PathBuf::from);
        let mut socket = Self { baud, link, next: None, name: String::new() };
        socket.make()?;
        Ok(socket)
    }

    pub(super) fn address(&self) -> SerialAddress {
        let path = self.link.as_ref().map_or_else(|| self.name.clone(), |link| link.display().to_string());
        SerialAddress { path, baud: self.baud, stop_bits: 1 }
    }

    pub(super) fn open(&mut self) -> io::Result<Pipe> {
        if self.next.is_none() {
            self.make().map_err(io::Error::other)?;
        }
        let pty = Arc::new(self.next.take().ok_or(io::ErrorKind::NotFound)?);
        let pacer = Pacer::new(self.address().bytes_per_second());
        let reader = Reader { pty: pty.clone(), free: interval(FREE_EVERY) };
        Ok(Pipe::new(reader, Writer { pty, pacer, unread_since: None }))
    }

    fn make(&mut self) -> anyhow::Result<()> {
        let (pty, name) = Pty::new().context("cannot open a pty")?;
        if let Some(link) = &self.link {
            make_room(link)?;
            std::os::unix::fs::symlink(&name, link)
                .with_context(|| format!("cannot create the link {}", link.display()))?;
        }
        (self.next, self.name) = (Some(pty), name);
        Ok(())
    }
}

impl Drop for PtySource {
    fn drop(&mut self) {
        if let Some(link) = &self.link
            && fs::read_link(link).is_ok_and(|target| target == Path::new(&self.name))
        {
            let _ = fs::remove_file(link);
        }
    }
}

/// Removes a link to a pty: one of ours, or one left by a killed simulator. Anything else stays.
fn make_room(link: &Path) -> anyhow::Result<()> {
    let shown = link.display();
    let remedy = "remove it, or choose another link=";
    match fs::read_link(link) {
        Ok(target) if target.starts_with(PTYS) => Ok(fs::remove_file(link)?),
        Ok(target) => bail!("{shown} is a link to {}, which is not a pty: {remedy}", target.display()),
        Err(_) if link.exists() => bail!("{shown} exists and is not a link to a pty: {remedy}"),
        Err(_) => Ok(()),
    }
}

struct Pty {
    master: AsyncFd<OwnedFd>,
    /// Kept open, so that the master outlives its clients, and nothing is echoed before they set it up.
    slave: OwnedFd,
}

impl Pty {
    fn new() -> io::Result<(Self, String)> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        fcntl_setfl(&master, OFlags::NONBLOCK)?;
        let name = ptsname(&master, Vec::new())?;
        let slave = open(&name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        let name = name.into_string().map_err(io::Error::other)?;
        // The replacement is `unsafe`, since the descriptor could be replaced or closed. That cannot happen here.
        #[allow(deprecated, reason = "no safe replacement exists")]
        let master = AsyncFd::new(master)?;
        Ok((Self { master, slave }, name))
    }

    fn has_many_unread(&self) -> bool {
        ioctl_fionread(&self.slave).is_ok_and(|unread| unread >= MANY_UNREAD_BYTES)
    }
}

struct Reader {
    pty: Arc<Pty>,
    free: Interval,
}

impl AsyncRead for Reader {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        while this.free.poll_tick(cx).is_ready() {
            // Their file locks still keep two clients apart.
            let _ = ioctl_tiocnxcl(&this.pty.slave);
        }
        loop {
            let mut ready = ready!(this.pty.master.poll_read_ready(cx))?;
            let unfilled = out.initialize_unfilled();
            match ready.try_io(|master| read(master, &mut *unfilled).map_err(io::Error::from)) {
                Ok(Ok(bytes)) => {
                    out.advance(bytes);
                    return Poll::Ready(Ok(()));
                }
                Ok(Err(error)) => return Poll::Ready(Err(error)),
                Err(_would_block) => {}
            }
        }
    }
}

struct Writer {
    pty: Arc<Pty>,
    pacer: Pacer,
    /// Since when many bytes have been unread.
    unread_since: Option<Instant>,
}

impl AsyncWrite for Writer {
    /// Never waits for a client, like a real line.
    fn poll_write(mut self: Pin<&mut Self>, _cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.pacer.wrote(bytes.len());
        self.unread_since = self.pty.has_many_unread().then(|| self.unread_since.unwrap_or_else(Instant::now));
        if self.unread_since.is_some_and(|since| since.elapsed() >= DISCARDED_AFTER) {
            let _ = tcflush(&self.pty.slave, QueueSelector::IFlush);
        }
        match write(self.pty.master.get_ref(), bytes) {
            Ok(_) | Err(Errno::AGAIN) => Poll::Ready(Ok(bytes.len())),
            Err(error) => Poll::Ready(Err(error.into())),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.pacer.poll_free(cx).map(Ok)
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[tokio::test]
    async fn link_replaces_nothing_but_a_link_to_a_pty() {
        let link = std::env::temp_dir().join(format!("wsg-link-{}", std::process::id()));
        let url = Url::parse(&format!("serial://pty?link={}", link.display())).unwrap();
        let refused = || PtySource::new(&url).err().map(|error| error.to_string()).unwrap_or_default();

        symlink("/dev/ttyUSB0", &link).unwrap();
        assert!(refused().contains("is a link to /dev/ttyUSB0, which is not a pty: remove it"), "{}", refused());
        assert_eq!(fs::read_link(&link).unwrap(), Path::new("/dev/ttyUSB0"), "it is left alone");
        fs::remove_file(&link).unwrap();

        fs::write(&link, "precious").unwrap();
        assert!(refused().contains("choose another link="), "{}", refused());
        assert_eq!(fs::read(&link).unwrap(), b"precious");
        fs::remove_file(&link).unwrap();

        symlink("/dev/pts/99999", &link).unwrap();
        let socket = PtySource::new(&url).unwrap();
        assert_eq!(fs::read_link(&link).unwrap(), Path::new(&socket.name), "what was left behind is replaced");
        drop(socket);
        assert!(!link.is_symlink(), "and removed at the end");
    }
}
