//! Random bytes for secrets.

use ring::error::Unspecified;
use ring::rand::{SecureRandom as _, SystemRandom};

/// Random bytes of a secret.
pub(super) const SECRET_BYTES: usize = 32;

/// # Errors
/// The operating system has no random numbers.
pub(super) fn secret_bytes() -> Result<[u8; SECRET_BYTES], Unspecified> {
    let mut bytes = [0; SECRET_BYTES];
    SystemRandom::new().fill(&mut bytes)?;
    Ok(bytes)
}
