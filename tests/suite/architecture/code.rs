//! Names that the files of `src` use of each other, except in test code. File names omit `.rs`.

use std::collections::{BTreeMap, BTreeSet};
use std::mem;

use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens;
use syn::visit::{self, Visit};
use syn::{
    Arm, Attribute, Block, ExprCall, Ident, ImplItem, Item, ItemEnum, ItemMod, ItemStatic, ItemStruct, ItemTrait,
    ItemType, ItemUse, Stmt, UseTree, Variant, Visibility,
};

use super::is_in;

/// For example `["wsg", "frame", "encode"]`.
type Path = Vec<String>;

/// Attributes of code that is not compiled into the gateway.
const NOT_SHIPPED: [&str; 5] = [
    "#[cfg(test)]",
    "#[cfg(any(test,fuzzing))]",
    "#[cfg(any(test,fuzzing,feature=\"fuzz\"))]",
    "#[cfg(any(test,fuzzing,feature=\"testing\"))]",
    "#[cfg(any(test,feature=\"testing\"))]",
];

/// Rooms that are crates of their own.
const CRATES: [&str; 6] = ["gripper", "model", "settings", "sim", "transport", "wsg"];

/// Constructors of queues, which take the capacity as first argument.
const QUEUES: &[&str] = &["mpsc::channel", "broadcast::channel", "broadcast::Sender::new", "sync_channel"];

#[derive(Debug, Default)]
pub struct Code {
    texts: BTreeMap<String, String>,
    /// File of each module.
    files: BTreeMap<Path, String>,
    /// Full path of each name that `use` brings into a module.
    aliases: BTreeMap<Path, Path>,
    /// File, full path, and path as written.
    names: BTreeSet<(String, Path, String)>,
    /// File of each type that other files can use.
    types: BTreeMap<String, String>,
    /// Statics, queues with an unnamed capacity, and types of one name.
    pub breaches: Vec<String>,
    // Position of the reader.
    file: String,
    module: Path,
    is_in_block: bool,
    is_ignored: bool,
}

impl Code {
    /// Reads the crates, the library and the binary from the texts of their files.
    pub fn new(texts: BTreeMap<String, String>) -> Self {
        let mut code = Self { texts, ..Self::default() };
        for name in
            CRATES.into_iter().filter(|name| code.texts.contains_key(&format!("{name}/mod"))).collect::<Vec<_>>()
        {
            code.module = vec![name.to_owned()];
            code.read(name);
        }
        code.module.clear();
        code.read("lib");
        code.module.push("main".to_owned());
        code.read("main");
        code
    }

    fn read(&mut self, file: &str) {
        let file = if self.texts.contains_key(file) { file.to_owned() } else { format!("{file}/mod") };
        let parsed = syn::parse_file(&self.texts[&file]).unwrap();
        self.files.insert(self.module.clone(), file.clone());
        let outer = mem::replace(&mut self.file, file);
        // A file without any names still belongs to a room.
        self.name(&["Self".to_owned()]);
        self.visit_file(&parsed);
        self.file = outer;
    }

    /// Returns each path that a file names: the file, the file that defines the item, and the path as written.
    pub fn names(&self) -> impl Iterator<Item = (&str, &str, &str)> {
        // A single word is a variable, even if a nearby module has the same name.
        let items =
            self.names.iter().filter(|(_, path, written)| written.contains("::") || !self.files.contains_key(path));
        items.map(|(file, path, written)| (&**file, self.definer(path), &**written))
    }

    /// Follows re-exports. Items from other crates count as defined in the naming file.
    fn definer(&self, path: &[String]) -> &str {
        let depth = (0..=path.len()).rev().find(|depth| self.files.contains_key(&path[..*depth])).unwrap();
        let item = &path[..path.len().min(depth + 1)];
        match self.aliases.get(item) {
            Some(alias) if !alias.starts_with(item) => self.definer(&[alias, &path[item.len()..]].concat()),
            _ => &self.files[&path[..depth]],
        }
    }

    /// Records a path, and returns it relative to the library, which names all crates.
    fn name(&mut self, path: &[String]) -> Path {
        let mut full = self.module.clone();
        let is_in_crate = full.first().is_some_and(|first| self.is_crate(first));
        for (place, part) in path.iter().enumerate() {
            match part.as_str() {
                "crate" if is_in_crate => full.truncate(1),
                "crate" | "wsg_gateway" => full.clear(),
                // A crate names another one.
                name if place == 0 && is_in_crate && path.len() > 1 && self.is_other_crate(name) => {
                    full = vec![name.to_owned()];
                }
                "super" => drop(full.pop()),
                "self" => {}
                part => full.push(part.to_owned()),
            }
        }
        // A visibility names a parent module rather than an item: `pub(super)`.
        if !self.is_ignored && !self.module.starts_with(&full) {
            self.names.insert((self.file.clone(), full.clone(), path.join("::")));
        }
        full
    }

    fn is_crate(&self, name: &str) -> bool {
        CRATES.contains(&name) && self.texts.contains_key(&format!("{name}/mod"))
    }

    /// Whether this is the name of a crate, and not that of a module beside the file.
    fn is_other_crate(&self, name: &str) -> bool {
        let beside = [&*self.module, &[name.to_owned()]].concat().join("/");
        self.is_crate(name) && !self.texts.keys().any(|file| is_in(file, &beside))
    }

    fn import(&mut self, mut path: Path, tree: &UseTree) {
        let (name, alias) = match tree {
            UseTree::Path(part) => {
                path.push(part.ident.to_string());
                return self.import(path, &part.tree);
            }
            UseTree::Group(group) => return group.items.iter().for_each(|tree| self.import(path.clone(), tree)),
            UseTree::Glob(_) => ("*".to_owned(), "*".to_owned()),
            UseTree::Name(item) => (item.ident.to_string(), item.ident.to_string()),
            UseTree::Rename(item) => (item.ident.to_string(), item.rename.to_string()),
        };
        let alias = if alias == "self" { path[path.len() - 1].clone() } else { alias };
        path.extend(Some(name).filter(|name| name != "self"));
        let full = self.name(&path);
        if !self.is_in_block {
            self.aliases.insert([&*self.module, &[alias]].concat(), full);
        }
    }

    fn declare(&mut self, visibility: &Visibility, name: &Ident) {
        if self.is_ignored || matches!(visibility, Visibility::Inherited) {
            return;
        }
        if let Some(other) = self.types.insert(name.to_string(), self.file.clone()) {
            self.breach(&format!("type {name} has the name of a type in src/{other}.rs"));
        }
    }

    fn breach(&mut self, what: &str) {
        if !self.is_ignored {
            self.breaches.push(format!("src/{}.rs: {what}", self.file));
        }
    }
}

/// Implements visits of nodes that declare a type.
macro_rules! declaring {
    ($($visit:ident: $node:ty),*) => {$(
        fn $visit(&mut self, node: &$node) {
            visit::$visit(self, node);
            self.declare(&node.vis, &node.ident);
        }
    )*};
}

/// Implements visits of nodes that can carry an attribute of [`NOT_SHIPPED`].
macro_rules! scoped {
    ($($visit:ident: $node:ty),*) => {$(
        fn $visit(&mut self, node: &$node) {
            let outer = self.is_ignored;
            visit::$visit(self, node);
            self.is_ignored = outer;
        }
    )*};
}

impl Visit<'_> for Code {
    scoped!(visit_arm: Arm, visit_impl_item: ImplItem, visit_item: Item, visit_stmt: Stmt, visit_variant: Variant);

    declaring!(
        visit_item_struct: ItemStruct, visit_item_enum: ItemEnum, visit_item_trait: ItemTrait, visit_item_type: ItemType
    );

    // A node's attributes are visited before its other parts.
    fn visit_attribute(&mut self, attribute: &Attribute) {
        visit::visit_attribute(self, attribute);
        self.is_ignored |= NOT_SHIPPED.contains(&&*written(attribute));
    }

    fn visit_block(&mut self, block: &Block) {
        let outer = mem::replace(&mut self.is_in_block, true);
        visit::visit_block(self, block);
        self.is_in_block = outer;
    }

    fn visit_item_mod(&mut self, item: &ItemMod) {
        self.module.push(item.ident.to_string());
        self.files.insert(self.module.clone(), self.file.clone());
        visit::visit_item_mod(self, item);
        if item.content.is_none() && !self.is_ignored {
            self.read(&self.module.join("/"));
        }
        self.module.pop();
    }

    fn visit_item_use(&mut self, item: &ItemUse) {
        visit::visit_item_use(self, item);
        let (tree, root) = (written(&item.tree), written(&item.leading_colon));
        // A module that re-exports from its own submodule does not itself use the item.
        let first = tree.trim_start_matches("self::").split("::").next().unwrap_or_default().to_owned();
        let below = [&*self.module, &[first]].concat().join("/");
        self.is_ignored |= !written(&item.vis).is_empty() && self.texts.keys().any(|file| is_in(file, &below));
        self.import(if root.is_empty() { vec![] } else { vec![root] }, &item.tree);
    }

    fn visit_path(&mut self, path: &syn::Path) {
        let parts = path.segments.iter().map(|part| part.ident.to_string());
        let parts = path.leading_colon.iter().map(written).chain(parts).collect::<Path>();
        self.name(&parts);
        visit::visit_path(self, path);
    }

    // Tokens of a macro follow no grammar.
    fn visit_token_stream(&mut self, tokens: &TokenStream) {
        let (mut path, mut colons) = (Path::new(), 0);
        for token in tokens.clone() {
            match token {
                TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
                TokenTree::Ident(part) => {
                    if mem::take(&mut colons) != 2 {
                        self.name(&mem::take(&mut path));
                    }
                    path.push(part.to_string());
                }
                TokenTree::Group(group) => self.visit_token_stream(&group.stream()),
                _ => colons = 0,
            }
        }
        self.name(&path);
    }

    fn visit_item_static(&mut self, item: &ItemStatic) {
        visit::visit_item_static(self, item);
        if !item.attrs.iter().any(|attribute| attribute.path().is_ident("global_allocator")) {
            self.breach(&format!("static {}: state needs an owner", item.ident));
        }
    }

    fn visit_expr_call(&mut self, call: &ExprCall) {
        visit::visit_expr_call(self, call);
        let (function, limit) = (written(&call.func), call.args.first());
        let is_constant = |name: &str| name.starts_with(char::is_uppercase) && name == name.to_uppercase();
        let is_named = |term: &str| term == "1" || term.rsplit("::").next().is_some_and(is_constant);
        let is_queue = |queue: &&str| function.split("::<").next().is_some_and(|function| function.ends_with(queue));
        if QUEUES.iter().any(is_queue) && !written(&limit).split('+').all(is_named) {
            self.breach(&format!("{function}: a queue needs a named limit"));
        }
    }
}

fn written(node: &impl ToTokens) -> String {
    node.to_token_stream().to_string().replace(' ', "")
}
