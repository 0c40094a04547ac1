//! The link to the device: transports, recordings, losses and slow lines.

mod link;
mod noisy_udp;
mod replay;
mod slow_line;
mod transports;
