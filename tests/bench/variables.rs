//! Environment variables of a bench.

/// Returns a number, or `default` if the variable is not set.
pub fn number(name: &str, default: usize) -> usize {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}
