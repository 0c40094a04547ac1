use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::io::ReadBuf;

use super::*;
use crate::gripper::actor::tests::{TCP, client, config};
use crate::gripper::model::Link;
use crate::gripper::recorder::NullRecorder;
use crate::transport::LinkProperties;

struct Datagrams(VecDeque<io::Result<&'static [u8]>>);

impl AsyncRead for Datagrams {
    fn poll_read(mut self: Pin<&mut Self>, _: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.0.pop_front() {
            Some(read) => Poll::Ready(read.map(|bytes| out.put_slice(bytes))),
            None => Poll::Pending,
        }
    }
}

#[tokio::test]
async fn available_bytes_are_read_at_once_and_errors_come_after_them() {
    let refused = Err(io::ErrorKind::ConnectionRefused.into());
    let mut reader = Datagrams([Ok(&b"first"[..]), Ok(&b"second"[..]), refused].into());
    let (mut incoming, mut failed) = (vec![0; 64], None);
    assert_eq!(read_all(&mut reader, &mut incoming, &mut failed).await.unwrap(), 11);
    assert_eq!(&incoming[..11], b"firstsecond");
    let error = read_all(&mut reader, &mut incoming, &mut failed).await.unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::ConnectionRefused);
}

/// A device whose connection takes forever, and whether an attempt is under way.
#[derive(Default)]
struct Distant(Arc<AtomicBool>);

struct Attempt(Arc<AtomicBool>);

impl Drop for Attempt {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

impl Connector for Distant {
    fn url(&self) -> String {
        "test://distant".to_owned()
    }

    fn properties(&self) -> LinkProperties {
        TCP
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        self.0.store(true, Ordering::Relaxed);
        let attempt = Attempt(self.0.clone());
        Box::pin(async move {
            let _attempt = attempt;
            std::future::pending().await
        })
    }
}

#[tokio::test(start_paused = true)]
async fn disconnect_is_answered_after_the_attempt_to_connect() {
    let distant = Distant::default();
    let is_connecting = distant.0.clone();
    let handle = spawn(config(TCP), Arc::new(distant), Arc::new(NullRecorder), RestoredState::default());
    tokio::task::yield_now().await;
    assert!(is_connecting.load(Ordering::Relaxed));
    handle.disconnect(client(), None).await.unwrap();
    assert!(!is_connecting.load(Ordering::Relaxed), "nothing can open a connection any more");
    assert_eq!(handle.state().link, Link::Released);
}
