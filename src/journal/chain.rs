//! The hash chains: each record's hash covers its body, its curve and the hash of the record before.

use sha2::{Digest, Sha256};

/// A SHA-256 digest.
pub(super) type Hash = [u8; 32];

/// A chain of records. Each has a table, with the same columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Chain {
    Events,
    Grips,
}

impl Chain {
    pub(super) const ALL: [Self; 2] = [Self::Events, Self::Grips];

    /// Name of the chain's table, also used in findings.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Events => "events",
            Self::Grips => "grips",
        }
    }

    /// Field of a body with the record's time.
    pub(super) const fn time_field(self) -> &'static str {
        match self {
            Self::Events => "at",
            Self::Grips => "started_at",
        }
    }
}

/// The end of a chain: its newest record, or the last removed one if none is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Tip {
    pub(super) seq: i64,
    pub(super) hash: Hash,
}

impl Tip {
    /// Reads a sequence number and a hash.
    pub(super) fn of_row(row: &rusqlite::Row<'_>) -> rusqlite::Result<Self> {
        Ok(Self { seq: row.get(0)?, hash: row.get(1)? })
    }

    /// Returns the end after one more record.
    pub(super) fn next(&self, body: &[u8], curve: &[u8]) -> Self {
        Self { seq: self.seq + 1, hash: hash(&self.hash, body, curve) }
    }
}

/// Hashes a record that follows another. The length of the body separates it from the curve.
pub(super) fn hash(previous: &Hash, body: &[u8], curve: &[u8]) -> Hash {
    let digest = Sha256::new().chain_update(previous).chain_update((body.len() as u64).to_be_bytes());
    digest.chain_update(body).chain_update(curve).finalize().into()
}

/// Hashes a persisted value. These are overwritten, so they are outside the chains.
pub(super) fn memory_hash(gripper: &str, key: &str, value: &str) -> Hash {
    Sha256::new().chain_update(format!("{gripper}\n{key}\n{value}")).finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hash_covers_previous_hash_body_curve_and_their_boundary() {
        let base = hash(&[0; 32], b"body", b"curve");
        for other in [
            hash(&[1; 32], b"body", b"curve"),
            hash(&[0; 32], b"bodz", b"curve"),
            hash(&[0; 32], b"body", b"curvf"),
            hash(&[0; 32], b"bodyc", b"urve"),
        ] {
            assert_ne!(base, other);
        }
        assert_eq!(Tip::default().next(b"body", b"curve"), Tip { seq: 1, hash: base });
    }
}
