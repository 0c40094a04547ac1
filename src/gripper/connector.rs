//! What a gripper needs of its link: somebody who connects. The transports do, and so can a simulated device.

use std::future::Future;
use std::io;
use std::pin::Pin;

use crate::transport::{Address, Pipe, Traits};

/// Makes links to one device.
pub trait Connector: Send + Sync + 'static {
    /// Where the device is, as a URL.
    fn url(&self) -> String;

    /// What its transport means for the protocol.
    fn traits(&self) -> Traits;

    /// Connects. Cancelled by dropping the future.
    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>>;
}

impl Connector for Address {
    fn url(&self) -> String {
        self.to_string()
    }

    fn traits(&self) -> Traits {
        Self::traits(self)
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        Box::pin(Self::connect(self))
    }
}
