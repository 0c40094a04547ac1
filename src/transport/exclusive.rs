//! One user for each device: two grippers whose addresses differ only in spelling (`localhost` and 127.0.0.1, or two
//! links to one serial port) must not both connect, because a device accepts one client.

use std::fmt;
use std::fs;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use futures_util::future::join_all;
use tokio::time::Instant;

use super::serial::SerialAddress;
use super::{Address, CONNECT_WITHIN, Pipe};

/// The devices that grippers of this process connect to.
#[derive(Debug, Clone, Default)]
pub struct DevicesInUse(Arc<Mutex<DeviceUsers>>);

#[derive(Debug, Default)]
struct DeviceUsers {
    users: Vec<DeviceUser>,
    next_id: u64,
}

#[derive(Debug)]
struct DeviceUser {
    id: u64,
    gripper: String,
    /// Ends at which the device was found at the newest attempt to connect.
    ends: Vec<DeviceEnd>,
}

/// A device's end of a link, with host name and path resolved. On CAN, the ids in the configuration tell devices apart.
#[derive(Debug, Clone, PartialEq, Eq)]
enum DeviceEnd {
    Tcp(SocketAddr),
    Udp(SocketAddr),
    Serial(PathBuf),
}

impl fmt::Display for DeviceEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Udp(address) => write!(f, "udp://{address}"),
            Self::Serial(path) => path.display().fmt(f),
        }
    }
}

/// Ends of the device at an address whose host has these addresses.
fn ends_of(address: &Address, resolved: &[SocketAddr]) -> Vec<DeviceEnd> {
    match address {
        Address::Tcp(_) => resolved.iter().map(canonical).map(DeviceEnd::Tcp).collect(),
        Address::Udp(_) => resolved.iter().map(canonical).map(DeviceEnd::Udp).collect(),
        Address::Serial(SerialAddress { path, .. }) => {
            vec![DeviceEnd::Serial(fs::canonicalize(path).unwrap_or_else(|_| path.into()))]
        }
        Address::Can(_) => Vec::new(),
    }
}

/// Turns an IPv4 address that is written as an IPv6 one into an IPv4 address. An IPv6 address keeps its zone.
fn canonical(address: &SocketAddr) -> SocketAddr {
    match address.ip().to_canonical() {
        IpAddr::V6(_) => *address,
        ip @ IpAddr::V4(_) => SocketAddr::new(ip, address.port()),
    }
}

impl DevicesInUse {
    /// The address of a gripper that connects to no device of another gripper.
    #[must_use]
    pub fn exclusive(&self, gripper: &str, address: Address) -> ExclusiveAddress {
        let mut device_users = self.lock();
        let id = device_users.next_id;
        device_users.next_id += 1;
        device_users.users.push(DeviceUser { id, gripper: gripper.to_owned(), ends: Vec::new() });
        ExclusiveAddress { address, id, gripper: gripper.to_owned(), devices: self.clone() }
    }

    /// Notes where a gripper's device is, unless it is the device of another gripper: then this gripper has none for now,
    /// so that two devices that swap their places do not keep each other out. After a reload, the same gripper can be here
    /// twice for a moment.
    fn claim(&self, id: u64, gripper: &str, ends: Vec<DeviceEnd>) -> io::Result<()> {
        let mut device_users = self.lock();
        let taken = device_users.users.iter().filter(|other| other.gripper != gripper).find_map(|other| {
            let end = ends.iter().find(|end| other.ends.contains(end))?;
            Some(format!(
                "{end} is the device of {} already, and a device accepts only one client: correct the url of one of the \
                 two, or remove one",
                other.gripper
            ))
        });
        if let Some(user) = device_users.users.iter_mut().find(|user| user.id == id) {
            user.ends = if taken.is_some() { Vec::new() } else { ends };
        }
        taken.map_or(Ok(()), |detail| Err(io::Error::new(io::ErrorKind::ResourceBusy, detail)))
    }

    fn lock(&self) -> MutexGuard<'_, DeviceUsers> {
        // No code panics while holding the lock; even then, the list would remain usable.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The address of a gripper's device. As long as this value exists, no other gripper connects to that device.
#[derive(Debug)]
pub struct ExclusiveAddress {
    address: Address,
    id: u64,
    gripper: String,
    devices: DevicesInUse,
}

impl ExclusiveAddress {
    #[must_use]
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Opens a pipe, like [`Address::connect`].
    ///
    /// # Errors
    /// Those of [`Address::connect`], or another gripper has this device.
    pub async fn connect(&self) -> io::Result<Pipe> {
        let deadline = Instant::now() + CONNECT_WITHIN;
        let resolved = self.address.resolve().await?;
        self.devices.claim(self.id, &self.gripper, ends_of(&self.address, &resolved))?;
        self.address.connect_to(&resolved, deadline).await
    }
}

impl Drop for ExclusiveAddress {
    fn drop(&mut self) {
        self.devices.lock().users.retain(|user| user.id != self.id);
    }
}

/// Resolves all host names, and returns the first two addresses of one device, by their indexes, with the reason. Hosts
/// that cannot be resolved now are left out.
pub async fn find_same_device(addresses: &[&Address]) -> Option<(usize, usize, String)> {
    let resolving = addresses.iter().map(|address| async {
        let resolved = address.resolve().await.unwrap_or_default();
        ends_of(address, &resolved)
    });
    let all = join_all(resolving).await;
    for (index, ends) in all.iter().enumerate() {
        for (other_index, other) in all[..index].iter().enumerate() {
            if let Some(end) = ends.iter().find(|end| other.contains(end)) {
                let detail = format!("both are at {end}, but a device accepts only one client");
                return Some((other_index, index, detail));
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use tokio::net::TcpListener;

    use super::*;

    async fn device() -> (TcpListener, u16) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        (listener, port)
    }

    fn at(host: &str, port: u16) -> Address {
        format!("tcp://{host}:{port}").parse().unwrap()
    }

    #[tokio::test]
    async fn device_under_another_name_is_not_connected_to() {
        let (listener, port) = device().await;
        let devices = DevicesInUse::default();
        let left = devices.exclusive("left", at("127.0.0.1", port));
        let right = devices.exclusive("right", at("localhost", port));
        let _first = left.connect().await.unwrap();
        listener.accept().await.unwrap();
        let error = right.connect().await.unwrap_err().to_string();
        assert!(error.starts_with(&format!("tcp://127.0.0.1:{port} is the device of left already")), "{error}");
        assert!(tokio::time::timeout(std::time::Duration::from_millis(50), listener.accept()).await.is_err());
        // Also while left reconnects; and left itself can connect again.
        left.connect().await.unwrap();
        // After a reload, the same gripper has another spelling.
        let renewed = devices.exclusive("left", at("localhost", port));
        renewed.connect().await.unwrap();
        drop(left);
        assert!(right.connect().await.is_err());
        drop(renewed);
        right.connect().await.unwrap();
    }

    #[tokio::test]
    async fn absent_device_stays_with_its_gripper() {
        let (listener, port) = device().await;
        drop(listener);
        let devices = DevicesInUse::default();
        let left = devices.exclusive("left", at("localhost", port));
        assert_eq!(left.connect().await.unwrap_err().kind(), io::ErrorKind::ConnectionRefused);
        let _listener = TcpListener::bind(("127.0.0.1", port)).await.unwrap();
        let right = devices.exclusive("right", at("[::ffff:127.0.0.1]", port));
        assert!(right.connect().await.unwrap_err().to_string().contains("of left already"));
    }

    /// Two adapters that were plugged in again can have each other's names.
    #[test]
    fn swapped_devices_are_claimed_again() {
        let devices = DevicesInUse::default();
        let [left, right] = ["left", "right"].map(|gripper| devices.exclusive(gripper, at("10.0.0.1", 1000)));
        let claim = |of: &ExclusiveAddress, port: &str| {
            devices.claim(of.id, &of.gripper, vec![DeviceEnd::Serial(port.into())]).is_ok()
        };
        assert!(claim(&left, "/dev/ttyUSB0") && claim(&right, "/dev/ttyUSB1"));
        assert!(!claim(&right, "/dev/ttyUSB0"));
        assert!(claim(&left, "/dev/ttyUSB1") && claim(&right, "/dev/ttyUSB0"));
    }

    #[tokio::test]
    async fn same_device_is_found_by_name_and_by_link() {
        let link = std::env::temp_dir().join(format!("wsg-same-device-{}", std::process::id()));
        std::os::unix::fs::symlink("/dev/null", &link).unwrap();
        let [device, linked] =
            ["/dev/null", link.to_str().unwrap()].map(|path| format!("serial://{path}").parse::<Address>().unwrap());
        let links = [device, at("10.0.0.1", 1000), linked];
        let found = find_same_device(&links.each_ref()).await;
        fs::remove_file(&link).unwrap();
        assert_eq!(found, Some((0, 2, "both are at /dev/null, but a device accepts only one client".to_owned())));
        let hosts = [at("localhost", 1000), at("127.0.0.1", 1000), at("no-such-host.invalid", 1000)];
        let (first, second, detail) = find_same_device(&hosts.each_ref()).await.unwrap();
        assert_eq!((first, second), (0, 1));
        assert!(detail.contains("tcp://127.0.0.1:1000"), "{detail}");
        assert_eq!(find_same_device(&hosts[1..].iter().collect::<Vec<_>>()).await, None);
    }
}
