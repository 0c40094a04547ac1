//! The interface for making links to a device: a transport, or a simulated device.

use std::future::Future;
use std::io;
use std::pin::Pin;

use transport::{Address, ExclusiveAddress, LinkProperties, Pipe};

/// Makes links to one device.
pub trait Connector: Send + Sync + 'static {
    fn url(&self) -> String;

    /// Properties of the transport that matter to the protocol.
    fn properties(&self) -> LinkProperties;

    /// Connects. Dropping the future cancels the attempt.
    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>>;
}

impl Connector for Address {
    fn url(&self) -> String {
        self.to_string()
    }

    fn properties(&self) -> LinkProperties {
        Self::properties(self)
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        Box::pin(Self::connect(self))
    }
}

impl Connector for ExclusiveAddress {
    fn url(&self) -> String {
        self.address().to_string()
    }

    fn properties(&self) -> LinkProperties {
        self.address().properties()
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        Box::pin(Self::connect(self))
    }
}
