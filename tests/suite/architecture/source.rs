//! A source file, as far as the rules need it: without comments and without what only tests compile, and every path of
//! the crate that it names.

use std::collections::BTreeSet;

/// One file of `src`.
#[derive(Debug, Clone)]
pub struct Source {
    /// Below `src`, e.g. `gripper/actor/mod.rs`.
    pub path: String,
    /// What is compiled outside of tests, without comments.
    pub code: String,
    /// The files that only tests compile, as declared here.
    pub test_files: Vec<String>,
}

impl Source {
    pub fn new(path: &str, text: &str) -> Self {
        let mut source = Self { path: path.to_owned(), code: String::new(), test_files: Vec::new() };
        let mut lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        while let Some(line) = lines.next() {
            if line.trim() == "#[cfg(test)]" {
                source.skip_test_item(&mut lines);
            } else {
                source.code += line;
                source.code.push('\n');
            }
        }
        source
    }

    /// Skips one item, whose end rustfmt puts at its own indentation.
    fn skip_test_item<'a>(&mut self, lines: &mut impl Iterator<Item = &'a str>) {
        let mut file = None;
        let Some(first) = lines.find(|line| {
            file =
                file.take().or_else(|| line.trim().strip_prefix("#[path = \"")?.strip_suffix("\"]").map(str::to_owned));
            !line.trim().starts_with('#')
        }) else {
            return;
        };
        if let Some(module) = first.split_once("mod ").and_then(|(_, rest)| rest.strip_suffix(';')) {
            let directory = match (&file, self.directory_of_modules()) {
                (Some(_), _) => self.path.rsplit_once('/').map_or("", |(directory, _)| directory).to_owned(),
                (None, directory) => directory,
            };
            self.test_files.push(format!("{directory}/{}", file.unwrap_or_else(|| module.to_owned())));
        } else if !first.ends_with([';', '}']) {
            let end = format!("{}}}", &first[..first.len() - first.trim_start().len()]);
            let _ = lines.find(|line| **line == end);
        }
    }

    fn directory_of_modules(&self) -> String {
        self.module().join("/")
    }

    /// The modules that lead to this file.
    fn module(&self) -> Vec<String> {
        let path = self.path.trim_end_matches(".rs").trim_end_matches("/mod");
        path.split('/').filter(|module| !matches!(*module, "lib" | "main")).map(str::to_owned).collect()
    }

    /// The room that this file belongs to: empty for `lib.rs` and `main.rs`.
    pub fn room(&self) -> String {
        self.module().into_iter().next().unwrap_or_default()
    }

    /// Every path of the crate that it names, from the crate's root, e.g. `wsg::session::Token`.
    pub fn names(&self) -> BTreeSet<String> {
        let mut names = BTreeSet::new();
        for root in ["crate::", "super::", "wsg_gateway::"] {
            for (at, _) in self.code.match_indices(root) {
                let before = &self.code[..at];
                if before.ends_with(|character: char| character.is_alphanumeric() || "_:$".contains(character)) {
                    continue;
                }
                let mut module = if root == "super::" { self.module() } else { Vec::new() };
                let mut rest = &self.code[at..];
                while let Some(above) = rest.strip_prefix("super::") {
                    module.pop();
                    rest = above;
                }
                rest = rest.strip_prefix("crate::").or_else(|| rest.strip_prefix("wsg_gateway::")).unwrap_or(rest);
                expand(&module.join("::"), rest, &mut names);
            }
        }
        names
    }
}

/// Follows a path, into its groups too. Returns what comes behind.
fn expand<'a>(prefix: &str, text: &'a str, names: &mut BTreeSet<String>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut group) = text.strip_prefix('{') {
        loop {
            group = group.trim_start_matches([',', ' ', '\n']);
            match group.strip_prefix('}') {
                Some(behind) => return behind,
                None if group.is_empty() => return group,
                None => group = expand(prefix, group, names),
            }
        }
    }
    let end = text.find(|character: char| !character.is_alphanumeric() && character != '_').unwrap_or(text.len());
    let (name, rest) = text.split_at(end);
    let path =
        if prefix.is_empty() || name.is_empty() { format!("{prefix}{name}") } else { format!("{prefix}::{name}") };
    if let Some(below) = rest.strip_prefix("::") {
        return expand(&path, below, names);
    }
    names.insert(path.trim_end_matches("::self").to_owned());
    // At least one character is passed, so that a group always ends; and a new name within it.
    let rest = rest.strip_prefix(" as ").map_or(rest, |alias| {
        alias.trim_start_matches(|character: char| character.is_alphanumeric() || character == '_')
    });
    if name.is_empty() { rest.get(1..).unwrap_or_default() } else { rest }
}
