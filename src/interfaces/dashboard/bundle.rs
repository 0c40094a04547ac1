//! Joins modules into scripts, so that a browser loads the page with few requests.
//!
//! Each module becomes a block, which hides its own names. Its exports become variables outside the block, so that an
//! import needs no code. That needs a unique name for each export. Libraries are minified in another style: each
//! becomes an object of its exports.
//!
//! The first script is a classic one, whose variables are global. The others are modules, which use those variables. A
//! module script that follows another one imports its variables too.

use std::collections::BTreeSet;
use std::fmt::Write as _;

/// Returns the text of an asset; empty if the asset does not exist.
pub(super) type Read<'a> = &'a dyn Fn(&str) -> String;

/// A script in the making.
#[derive(Debug, Default)]
pub(super) struct Bundle {
    /// Modules that this script or an earlier one has.
    joined: BTreeSet<String>,
    script: String,
    /// Variables that this script declares: the exports of its modules.
    variables: Vec<String>,
    /// Names that the entry re-exports from other modules.
    reexports: Vec<String>,
}

/// The parts of a module.
#[derive(Debug, Default)]
struct Module {
    /// Paths of imported modules, in order.
    imports: Vec<String>,
    /// Exported variables.
    exports: Vec<String>,
    /// Names that the module re-exports from other modules of this page.
    reexports: Vec<String>,
    block: String,
}

impl Bundle {
    /// Joins a module and all its imports into a classic script.
    pub(super) fn first(read: Read, entry: &str) -> Self {
        let mut bundle = Self { script: "'use strict';\n".to_owned(), ..Self::default() };
        bundle.join(read, entry);
        bundle
    }

    /// Joins a module, and its imports that this script lacks, into a module script that exports all its variables.
    pub(super) fn module(&self, read: Read, entry: &str) -> Self {
        self.next(read, entry, String::new())
    }

    /// Like `module`, for a script that follows this module script, whose file is `file`.
    pub(super) fn module_after(&self, read: Read, entry: &str, file: &str) -> Self {
        self.next(read, entry, format!("import {{ {} }} from './{file}';\n", self.variables.join(", ")))
    }

    fn next(&self, read: Read, entry: &str, script: String) -> Self {
        let mut bundle = Self { joined: self.joined.clone(), script, ..Self::default() };
        bundle.join(read, entry);
        let mut names: BTreeSet<_> = bundle.variables.iter().collect();
        names.extend(&bundle.reexports);
        let names: Vec<_> = names.into_iter().map(String::as_str).collect();
        let exports = format!("export {{ {} }};\n", names.join(", "));
        bundle.script.push_str(&exports);
        bundle
    }

    pub(super) fn script(&self) -> &str {
        &self.script
    }

    fn join(&mut self, read: Read, path: &str) {
        if !self.joined.insert(path.to_owned()) {
            return;
        }
        let text = read(path);
        if is_library(path) {
            let (imports, code) = library(path, &text);
            for import in &imports {
                self.join(read, import);
            }
            self.script.push_str(&code);
            return;
        }
        let module = Module::parse(path, &text);
        for import in &module.imports {
            self.join(read, import);
        }
        if !module.exports.is_empty() {
            let _ = writeln!(self.script, "let {};", module.exports.join(", "));
            self.variables.extend(module.exports);
        }
        let _ = write!(self.script, "{{\n{}}}\n", module.block);
        self.reexports = module.reexports;
    }
}

impl Module {
    fn parse(path: &str, text: &str) -> Self {
        let mut module = Self::default();
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            let trimmed = line.trim_start();
            if trimmed.starts_with("/**") {
                let mut last = trimmed;
                while !last.ends_with("*/") {
                    let Some(next) = lines.next() else { break };
                    last = next;
                }
            } else if line.starts_with("import ") || line.starts_with("export {") {
                let mut statement = line.to_owned();
                while !statement.ends_with(';') {
                    let Some(next) = lines.next() else { break };
                    statement.push_str(next);
                }
                module.take(path, &statement);
            } else if let Some(declared) = line.strip_prefix("export ") {
                module.declare(declared);
            } else if !trimmed.is_empty() && !trimmed.starts_with("//") {
                // Indentation matters to no text of a page.
                let _ = writeln!(module.block, "{trimmed}");
            }
        }
        module
    }

    /// Takes an `import` statement or a re-export.
    fn take(&mut self, path: &str, statement: &str) {
        let Some((names, from)) = statement.split_once(" from ") else {
            self.imports.extend(quoted(statement).map(|from| resolved(path, from)));
            return;
        };
        let Some(from) = quoted(from).map(|from| resolved(path, from)) else { return };
        let object = object(&from);
        match (names.split_once('{'), is_library(&from)) {
            (Some(_), false) if names.starts_with("import") => {}
            (Some((_, names)), false) => self.reexports.extend(listed(names)),
            (Some((word, names)), true) => {
                let names: Vec<_> = listed(names).collect();
                let wanted = names.join(", ");
                let code = if word.starts_with("import") {
                    format!("const {{ {wanted} }} = {object};")
                } else {
                    self.exports.extend(names);
                    format!("({{ {wanted} }} = {object});")
                };
                let _ = writeln!(self.block, "{code}");
            }
            (None, _) => {
                let name = names.trim_start_matches("import ");
                let _ = writeln!(self.block, "const {name} = {object}.default;");
            }
        }
        self.imports.push(from);
    }

    /// Assigns an exported declaration to its variable.
    fn declare(&mut self, declared: &str) {
        let words = ["const ", "let ", "async function ", "function ", "class "];
        let Some((word, rest)) = words.iter().find_map(|word| Some((*word, declared.strip_prefix(word)?))) else {
            return;
        };
        let end = rest.find(|char: char| !char.is_alphanumeric() && char != '_' && char != '$').unwrap_or(rest.len());
        let name = &rest[..end];
        let is_value = word == "const " || word == "let ";
        let _ = if is_value { writeln!(self.block, "{rest}") } else { writeln!(self.block, "{name} = {declared}") };
        self.exports.push(name.to_owned());
    }
}

fn is_library(path: &str) -> bool {
    path.starts_with("vendor/")
}

/// Returns a library's imports, and the code of its object.
fn library(path: &str, text: &str) -> (Vec<String>, String) {
    let mut imports = Vec::new();
    let mut before = String::new();
    let mut members = Vec::new();
    let mut body = text.to_owned();
    while let Some((names, from, rest)) = cut(&body, "import{") {
        let from = resolved(path, &from);
        let _ = writeln!(before, "const {{{}}} = {};", names.replace(" as ", ":"), object(&from));
        imports.push(from);
        body = rest;
    }
    while let Some((names, from, rest)) = cut(&body, "export{") {
        for name in names.split(',') {
            let (inner, outer) = name.split_once(" as ").unwrap_or((name, name));
            members.push(if from.is_empty() {
                format!("{outer}: {inner}")
            } else {
                format!("{outer}: {}.{inner}", object(&resolved(path, &from)))
            });
        }
        body = rest;
    }
    if body.contains("export default ") {
        body = body.replace("export default ", "const $default = ");
        members.push("default: $default".to_owned());
    }
    let code = format!(
        "const {} = (() => {{\n{before}{}\nreturn {{ {} }};\n}})();\n",
        object(path),
        body.trim_end(),
        members.join(", ")
    );
    (imports, code)
}

/// Cuts a minified statement out of a text. Returns its names, the quoted path or an empty one, and the rest.
fn cut(text: &str, begin: &str) -> Option<(String, String, String)> {
    let (before, after) = text.split_once(begin)?;
    let (names, after) = after.split_once('}')?;
    let (from, after) = match after.strip_prefix("from\"") {
        Some(after) => after.split_once('"')?,
        None => ("", after),
    };
    Some((names.to_owned(), from.to_owned(), format!("{before}{}", after.trim_start_matches(';'))))
}

/// Name of a library's object.
fn object(path: &str) -> String {
    let name = path.rsplit('/').next().unwrap_or(path).trim_end_matches(".js");
    format!("${}", name.replace('-', "_"))
}

/// Names of a list that ends with a brace.
fn listed(names: &str) -> impl Iterator<Item = String> {
    names.trim_end().trim_end_matches('}').split(',').map(|name| name.trim().to_owned()).filter(|name| !name.is_empty())
}

/// The text between single quotes.
fn quoted(text: &str) -> Option<&str> {
    Some(text.split_once('\'')?.1.split_once('\'')?.0)
}

/// The path of an import, relative to the assets.
fn resolved(path: &str, import: &str) -> String {
    let mut parts: Vec<_> = path.split('/').collect();
    parts.pop();
    for part in import.split('/') {
        match part {
            "." => {}
            ".." => drop(parts.pop()),
            part => parts.push(part),
        }
    }
    parts.join("/")
}
