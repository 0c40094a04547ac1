//! Names in `hosts`, by which clients call the gateway.

use super::{ConfigError, File};
use crate::transport::host::check_host;

pub(super) fn hosts(file: Option<&File>) -> Result<Vec<String>, ConfigError> {
    let Some(file) = file else { return Ok(Vec::new()) };
    for host in &file.content.hosts {
        check_host(host.get_ref())
            .map_err(|error| ConfigError::at(&file.place(host.span().start), format!("hosts has {error}")))?;
    }
    Ok(file.content.hosts.iter().map(|host| host.get_ref().clone()).collect())
}
