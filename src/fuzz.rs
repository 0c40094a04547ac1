//! Fuzz targets: functions that panic if untrusted bytes violate a guarantee. `tests/fuzz` searches for such bytes, and
//! the test here replays its corpora.

use crate::{config, interfaces, journal, operations, wsg};

/// A function that checks code with arbitrary bytes.
pub type Target = fn(&[u8]);

/// All targets by name.
pub const TARGETS: [(&str, Target); 8] = [
    ("body", operations::parameters::fuzz::body),
    ("config", config::fuzz::file),
    ("frames", wsg::fuzz::frames),
    ("json_rpc", interfaces::websocket::fuzz::message),
    ("modbus", interfaces::modbus::fuzz::stream),
    ("payloads", wsg::fuzz::payloads),
    ("recovery", journal::fuzz::recovery),
    ("wsg_port", interfaces::wsg_port::fuzz::session),
];

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn corpora_pass() {
        for (name, target) in TARGETS {
            let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(name);
            let files: Vec<_> = std::fs::read_dir(&corpus).unwrap().map(|file| file.unwrap().path()).collect();
            assert!(!files.is_empty(), "{} is empty", corpus.display());
            for file in files {
                println!("{}", file.display());
                target(&std::fs::read(file).unwrap());
            }
        }
    }
}
