//! Query parameters of a request. Unknown, repeated and invalid parameters are named in the problem.

use http::Uri;
use jiff::Timestamp;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use strum::VariantArray;
use url::form_urlencoded;

use super::values::shortened;
use crate::operations::problem::Problem;

#[derive(Debug)]
pub struct QueryString(Vec<(String, String)>);

impl QueryString {
    /// Parses the query of a URI. [`QueryString::only`] checks the names.
    pub fn of(uri: &Uri) -> Self {
        Self(form_urlencoded::parse(uri.query().unwrap_or_default().as_bytes()).into_owned().collect())
    }

    /// Refuses parameters that are not `known`, since a misspelt filter would have no effect.
    pub fn only(self, known: &[&str]) -> Result<Self, Problem> {
        match self.0.iter().find(|(name, _)| !known.contains(&name.as_str())) {
            Some((name, _)) => {
                let name = shortened(name);
                let detail = format!("unknown query parameter {name:?}; known: {}", known.join(", "));
                Err(Problem::malformed(name, detail))
            }
            None => Ok(self),
        }
    }

    /// Returns the parameters of a read as the fields of an object.
    pub fn fields(&self, names: &[String]) -> Result<Map<String, Value>, Problem> {
        let mut fields = Map::new();
        for name in names {
            if let Some(value) = self.one(name)? {
                fields.insert(name.clone(), value.into());
            }
        }
        Ok(fields)
    }

    /// Returns all parameters as the fields of an object.
    pub fn all(&self) -> Result<Map<String, Value>, Problem> {
        let mut all = Map::new();
        for (name, value) in &self.0 {
            if all.insert(name.clone(), value.as_str().into()).is_some() {
                return Err(repeated(name));
            }
        }
        Ok(all)
    }

    pub fn one(&self, name: &str) -> Result<Option<&str>, Problem> {
        let mut given = self.0.iter().filter(|(key, _)| key == name).map(|(_, value)| value.as_str());
        match (given.next(), given.next()) {
            (one, None) => Ok(one),
            _ => Err(repeated(name)),
        }
    }

    /// Parses a parameter; the problem says that it must be `what`.
    pub fn parsed<T>(
        &self,
        name: &str,
        what: &str,
        parse: impl FnOnce(&str) -> Option<T>,
    ) -> Result<Option<T>, Problem> {
        let Some(text) = self.one(name)? else { return Ok(None) };
        match parse(text) {
            Some(value) => Ok(Some(value)),
            None => Err(Problem::malformed(name, format!("{name} must be {what}")).value(Some(text.into()))),
        }
    }

    /// Parses one of an enumeration's words.
    pub fn word<T: DeserializeOwned + Serialize + VariantArray>(&self, name: &str) -> Result<Option<T>, Problem> {
        self.parsed(name, &format!("one of {}", words::<T>()), |text| serde_json::from_value(Value::from(text)).ok())
    }

    pub fn time(&self, name: &str) -> Result<Option<Timestamp>, Problem> {
        self.parsed(
            name,
            "a time like 2026-11-21T09:00:00Z (RFC 3339), before 9999-12-30; write + as %2B in a URL",
            |text| text.parse().ok(),
        )
    }
}

/// The words of an enumeration, as an error message lists them.
pub fn words<T: Serialize + VariantArray>() -> String {
    let words = T::VARIANTS.iter().map(|word| json!(word).as_str().unwrap_or_default().to_owned());
    words.collect::<Vec<_>>().join(", ")
}

fn repeated(name: &str) -> Problem {
    let name = shortened(name);
    Problem::malformed(&name, format!("{name} is given more than once"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameters(query: &str) -> QueryString {
        QueryString::of(&format!("/events?{query}").parse().unwrap())
    }

    #[test]
    fn unknown_or_repeated_parameter_is_named() {
        let unknown = parameters("griper=left").only(&["gripper"]).unwrap_err();
        assert_eq!(serde_json::to_value(unknown.members()).unwrap()["field"], "griper");
        assert!(parameters("kind=a&kind=b").one("kind").is_err());
        assert!(parameters("kind=a&from=b&kind=c").all().is_err());
        assert_eq!(parameters("kind=a&from=b").all().unwrap().len(), 2);
        assert_eq!(parameters("gripper=left").only(&["gripper"]).unwrap().one("gripper").unwrap(), Some("left"));
    }

    #[test]
    fn times_are_rfc_3339() {
        assert!(parameters("from=2026-11-21T09:00:00Z").time("from").unwrap().is_some());
        assert!(parameters("from=2026-11-21T10:00:00%2B01:00").time("from").unwrap().is_some());
        assert!(parameters("from=yesterday").time("from").is_err());
    }
}
