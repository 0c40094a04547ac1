//! The chain of hashes: each record's hash covers its body, its curve and the hash before it.

use sha2::{Digest, Sha256};

/// SHA-256.
pub(super) type Hash = [u8; 32];

/// What is chained: two tables of the same columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Chain {
    Events,
    Grips,
}

impl Chain {
    pub(super) const ALL: [Self; 2] = [Self::Events, Self::Grips];

    /// Its table, and how findings name it.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Events => "events",
            Self::Grips => "grips",
        }
    }

    /// The field of a body that says when it was.
    pub(super) const fn time_field(self) -> &'static str {
        match self {
            Self::Events => "at",
            Self::Grips => "started_at",
        }
    }
}

/// The end of a chain: its newest record, or what attests the removed ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Tip {
    pub(super) seq: i64,
    pub(super) hash: Hash,
}

impl Tip {
    /// The end after one more record.
    pub(super) fn next(&self, body: &[u8], curve: &[u8]) -> Self {
        Self { seq: self.seq + 1, hash: hash(&self.hash, body, curve) }
    }
}

/// The hash of a record behind another. The body's length keeps it apart from the curve.
pub(super) fn hash(previous: &Hash, body: &[u8], curve: &[u8]) -> Hash {
    let digest = Sha256::new().chain_update(previous).chain_update((body.len() as u64).to_be_bytes());
    digest.chain_update(body).chain_update(curve).finalize().into()
}

/// The hash of a remembered value, which is no part of a chain: it is overwritten.
pub(super) fn memory_hash(gripper: &str, key: &str, value: &str) -> Hash {
    Sha256::new().chain_update(format!("{gripper}\n{key}\n{value}")).finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hash_depends_on_all_that_it_covers_and_on_where_the_body_ends() {
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
