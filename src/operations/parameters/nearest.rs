//! Suggestions for misspelt names.

use strsim::normalized_damerau_levenshtein;

/// Least similarity of a name that is suggested: with four letters, two of them may be wrong.
const MIN_SIMILARITY: f64 = 0.5;

/// Longest name that is compared, in bytes. A comparison takes time in proportion to the square of the length.
const MAX_BYTES: usize = 64;

/// Returns how similar a given name is to a known one, from 0 to 1, or `None` if they have too little in common.
pub fn similarity(given: &str, known: &str) -> Option<f64> {
    if given.len() > MAX_BYTES {
        return None;
    }
    Some(normalized_damerau_levenshtein(given, known)).filter(|similarity| *similarity >= MIN_SIMILARITY)
}

/// Returns a question after the most similar name, which follows the statement that a name is unknown.
pub fn did_you_mean<'a>(given: &str, known: impl Iterator<Item = &'a str>) -> String {
    let similar = known.filter_map(|known| Some((similarity(given, known)?, known)));
    let nearest = similar.max_by(|one, other| one.0.total_cmp(&other.0));
    nearest.map_or_else(String::new, |(_, name)| format!(": did you mean {name}?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn suggestion(given: &str) -> String {
        did_you_mean(given, ["move", "grip", "release"].into_iter())
    }

    #[test]
    fn nearest_name_is_suggested() {
        assert_eq!(suggestion("grasp"), ": did you mean grip?");
        assert_eq!(suggestion("Release"), ": did you mean release?");
        assert_eq!(suggestion("acknowledge"), "");
        assert_eq!(suggestion(""), "");
        assert_eq!(suggestion(&"grip".repeat(100)), "");
    }
}
