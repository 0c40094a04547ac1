//! Two idioms that hide what happens: several values bound by one `let`, and closures with a name.

use syn::visit::{self, Visit};
use syn::{Attribute, Expr, ItemMod, Local, Meta, Pat};

/// Maximum number of `let (a, b) = (x, y);` in `src`, without tests.
const MAX_TUPLE_LETS: usize = 20;

/// Maximum number of `let name = |…| …;` in `src`, without tests.
const MAX_NAMED_CLOSURES: usize = 40;

#[derive(Debug, Default)]
struct Idioms {
    tuple_lets: usize,
    named_closures: usize,
}

impl<'ast> Visit<'ast> for Idioms {
    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        if !module.attrs.iter().any(is_for_tests) {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_local(&mut self, local: &'ast Local) {
        let pattern = match &local.pat {
            Pat::Type(typed) => typed.pat.as_ref(),
            pattern => pattern,
        };
        match (pattern, local.init.as_ref().map(|init| init.expr.as_ref())) {
            (Pat::Tuple(_), Some(Expr::Tuple(_))) => self.tuple_lets += 1,
            (Pat::Ident(_), Some(Expr::Closure(_))) => self.named_closures += 1,
            _ => {}
        }
        visit::visit_local(self, local);
    }
}

fn is_for_tests(attribute: &Attribute) -> bool {
    match &attribute.meta {
        Meta::List(list) => list.path.is_ident("cfg") && list.tokens.to_string() == "test",
        _ => false,
    }
}

fn idioms_of<'a>(texts: impl Iterator<Item = &'a str>) -> Idioms {
    let mut idioms = Idioms::default();
    for text in texts {
        idioms.visit_file(&syn::parse_file(text).unwrap());
    }
    idioms
}

#[test]
fn code_is_plain() {
    let texts = super::texts("src");
    let is_test = |file: &str| file.split('/').any(|part| part == "tests") || file.ends_with("_tests");
    let idioms = idioms_of(texts.iter().filter(|(file, _)| !is_test(file)).map(|(_, text)| text.as_str()));
    assert!(idioms.tuple_lets <= MAX_TUPLE_LETS, "write a let for each value: {idioms:?}");
    assert!(idioms.named_closures <= MAX_NAMED_CLOSURES, "write functions in place of named closures: {idioms:?}");
}

#[test]
fn idioms_are_counted_outside_tests() {
    let code = "fn f() { let (a, b): (u8, u8) = (1, 2); let g = move |x| x; let (c, d) = pair(); let h = |x| x; }
        #[cfg(test)] mod tests { fn f() { let (a, b) = (1, 2); } }";
    let Idioms { tuple_lets, named_closures } = idioms_of([code].into_iter());
    assert_eq!(tuple_lets, 1);
    assert_eq!(named_closures, 2);
}
