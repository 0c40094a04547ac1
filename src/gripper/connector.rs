//! The interface to whatever connects a gripper: a transport, or a simulated device.

use std::future::Future;
use std::io;
use std::pin::Pin;

use crate::transport::{Address, Pipe, Traits};

/// Makes links to one device.
pub trait Connector: Send + Sync + 'static {
    /// URL of the device.
    fn url(&self) -> String;

    /// Properties of the transport that matter to the protocol.
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
