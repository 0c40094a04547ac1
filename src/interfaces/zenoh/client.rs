//! The identity of a client on Zenoh.

use crate::access::{Access, ClientOrigin, Credential, Identity, Unauthorized};
use crate::fleet::keys::MAX_CLIENT_BYTES;
use crate::model::{Client, Door, ShownName};

/// Returns a client by the name that it claims. A client with a token is named after its token instead.
pub fn client(name: Option<&ShownName<MAX_CLIENT_BYTES>>) -> Client {
    let name = name.map_or("unknown", ShownName::as_str);
    Client::new(format!("zenoh:{name}"), Door::Zenoh)
}

/// Returns the rights of a client: those of its token, or else those of the Zenoh network, which has an access control
/// of its own.
///
/// # Errors
/// The reason why the token is refused.
pub fn identity(access: &Access, credential: &Credential) -> Result<Identity, Unauthorized> {
    match credential {
        Credential::None => Ok(access.of_network()),
        credential => access.identify(credential, &ClientOrigin::default()),
    }
}
