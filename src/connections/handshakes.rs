//! Turns of TLS handshakes, so that a flood of them from one address leaves processor time for others.
//!
//! A handshake takes as much processor time as many requests. Few handshakes of one address run at the same time. A
//! random one of those that wait is next: with the oldest or the newest first, a flood could keep out a certain one.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rand::RngExt as _;
use tokio::sync::oneshot;

use crate::connections::admission;

/// Handshakes of one address that run at the same time.
const AT_ONCE: usize = 4;

#[derive(Debug, Clone, Default)]
pub(crate) struct Handshakes(Arc<Mutex<HashMap<IpAddr, Peer>>>);

#[derive(Debug, Default)]
struct Peer {
    running: usize,
    /// The admission of connections bounds their number.
    waiting: Vec<oneshot::Sender<Turn>>,
}

/// The turn of a handshake, until it is dropped.
#[derive(Debug)]
pub(crate) struct Turn {
    handshakes: Handshakes,
    peer: IpAddr,
}

impl Handshakes {
    /// Waits for the turn of a handshake.
    pub(crate) async fn turn(&self, peer: IpAddr) -> Turn {
        let peer = admission::peer(peer);
        let waiting = {
            let mut peers = self.peers();
            let known = peers.entry(peer).or_default();
            if known.running < AT_ONCE {
                known.running += 1;
                return Turn { handshakes: self.clone(), peer };
            }
            let (turn, waiting) = oneshot::channel();
            known.waiting.retain(|turn| !turn.is_closed());
            known.waiting.push(turn);
            waiting
        };
        match waiting.await {
            Ok(turn) => turn,
            // Every waiting handshake gets its turn.
            Err(_) => std::future::pending().await,
        }
    }

    fn peers(&self) -> MutexGuard<'_, HashMap<IpAddr, Peer>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let next = {
            let mut peers = self.handshakes.peers();
            let Some(known) = peers.get_mut(&self.peer) else { return };
            known.waiting.retain(|turn| !turn.is_closed());
            let next = (!known.waiting.is_empty())
                .then(|| known.waiting.swap_remove(rand::rng().random_range(0..known.waiting.len())));
            if next.is_none() {
                known.running -= 1;
                if known.running == 0 {
                    peers.remove(&self.peer);
                }
            }
            next
        };
        if let Some(next) = next {
            // If the handshake has just been given up, its turn is dropped here, and the next one begins.
            let _ = next.send(Self { handshakes: self.handshakes.clone(), peer: self.peer });
        }
    }
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt as _;

    use super::*;

    #[tokio::test]
    async fn waiting_handshakes_get_every_turn_that_ends() {
        let (handshakes, flood) = (Handshakes::default(), IpAddr::from([127, 0, 0, 2]));
        let mut running = Vec::new();
        for _ in 0..AT_ONCE {
            running.push(handshakes.turn(flood).await);
        }
        let mut waiting: Vec<_> = (0..3).map(|_| Box::pin(handshakes.turn(flood))).collect();
        assert!(waiting.iter_mut().all(|turn| turn.as_mut().now_or_never().is_none()));
        assert!(handshakes.turn([127, 0, 0, 1].into()).now_or_never().is_some(), "another address does not wait");
        let [one, other] = ["2001:db8:0:1::1", "2001:db8:0:1::2"].map(|address| address.parse::<IpAddr>().unwrap());
        let network: Vec<_> = (0..AT_ONCE).filter_map(|_| handshakes.turn(one).now_or_never()).collect();
        assert_eq!(network.len(), AT_ONCE);
        assert!(handshakes.turn(other).now_or_never().is_none(), "a machine can use all addresses of its /64");
        drop(network);
        // One of those that wait has given up.
        drop(waiting.pop());
        running.pop();
        let got: Vec<_> = waiting.iter_mut().filter_map(|turn| turn.as_mut().now_or_never()).collect();
        assert_eq!(got.len(), 1);
        drop((got, running, waiting));
        assert!(handshakes.peers().is_empty());
    }
}
