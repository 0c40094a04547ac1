//! Programs of this machine that are connected to a device.

use std::fs;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

/// Number of an established connection in `/proc/net/tcp` (proc(5)).
const ESTABLISHED: &str = "01";

/// A connection from this machine to a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct DeviceClient {
    /// Process id and name, if this user may see them.
    pub(super) process: Option<String>,
}

/// Returns the first client of one of these addresses.
pub(super) fn of(devices: &[SocketAddr]) -> Option<DeviceClient> {
    let tables = ["/proc/net/tcp", "/proc/net/tcp6"].map(|path| fs::read_to_string(path).unwrap_or_default());
    let inode = tables.iter().flat_map(|table| table.lines()).filter_map(connection);
    let (_, inode) = inode.into_iter().find(|(remote, _)| devices.contains(remote))?;
    Some(DeviceClient { process: owner(&inode) })
}

/// Parses a line as the remote address and the inode of an established connection.
fn connection(line: &str) -> Option<(SocketAddr, String)> {
    let fields: Vec<_> = line.split_whitespace().collect();
    let remote = fields.get(2)?;
    let state = fields.get(3)?;
    let inode = fields.get(9)?;
    let (ip, port) = remote.split_once(':')?;
    let address = SocketAddr::new(address(ip)?.to_canonical(), u16::from_str_radix(port, 16).ok()?);
    (*state == ESTABLISHED).then(|| (address, (*inode).to_owned()))
}

/// Parses an address: words in the machine's byte order.
fn address(hex: &str) -> Option<IpAddr> {
    let words = hex.as_bytes().chunks(8).map(|word| u32::from_str_radix(str::from_utf8(word).ok()?, 16).ok());
    let bytes: Vec<u8> = words.collect::<Option<Vec<_>>>()?.into_iter().flat_map(u32::to_ne_bytes).collect();
    match <[u8; 4]>::try_from(bytes.as_slice()) {
        Ok(bytes) => Some(Ipv4Addr::from(bytes).into()),
        Err(_) => Some(Ipv6Addr::from(<[u8; 16]>::try_from(bytes.as_slice()).ok()?).into()),
    }
}

/// Finds the process that has a socket open.
fn owner(inode: &str) -> Option<String> {
    let socket = format!("socket:[{inode}]");
    for process in fs::read_dir("/proc").ok()?.flatten() {
        let Some(id) = process.file_name().to_str().filter(|id| id.parse::<u32>().is_ok()).map(str::to_owned) else {
            continue;
        };
        let mut files = fs::read_dir(process.path().join("fd")).into_iter().flatten().flatten();
        if files.any(|file| fs::read_link(file.path()).is_ok_and(|target| target.as_os_str() == socket.as_str())) {
            let name = fs::read_to_string(process.path().join("comm")).unwrap_or_default();
            return Some(format!("{} (process {id})", name.trim()));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn own_connection_is_found() {
        for local in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(device) = std::net::TcpListener::bind(local) else { continue };
            let address = device.local_addr().unwrap();
            assert_eq!(of(&[address]), None);
            let _client = std::net::TcpStream::connect(address).unwrap();
            let process = of(&[address]).unwrap().process.unwrap();
            assert!(process.ends_with(&format!("(process {})", std::process::id())), "{process}");
        }
    }
}
