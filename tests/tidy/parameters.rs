//! No parameters packed into a tuple to get below a limit.

use syn::visit::{self, Visit};
use syn::{FnArg, Pat, Signature, Type};

use super::sources::{assert_none, is_for_tests, name, parsed, product_files};

/// Functions of a file whose parameters are packed.
#[derive(Default)]
struct Packed {
    found: Vec<String>,
}

impl Packed {
    fn check(&mut self, signature: &Signature) {
        for (i, argument) in signature.inputs.iter().enumerate() {
            if let FnArg::Typed(typed) = argument
                && let Some(why) = packed(&typed.pat, &typed.ty)
            {
                self.found.push(format!("fn {}, parameter {}: {why}", signature.ident, i + 1));
            }
        }
    }
}

/// Why a parameter counts as packed. A tuple that is taken apart on the way in is several parameters; one that is
/// not may be a pair of numbers, such as a size in pixels, and nothing else.
fn packed(pattern: &Pat, of: &Type) -> Option<&'static str> {
    let mut pattern = pattern;
    while let Pat::Reference(inner) = pattern {
        pattern = &inner.pat;
    }
    if matches!(pattern, Pat::Tuple(_)) {
        return Some("a tuple that is taken apart");
    }
    let mut of = of;
    loop {
        of = match of {
            Type::Reference(inner) => &inner.elem,
            Type::Paren(inner) => &inner.elem,
            _ => break,
        };
    }
    let Type::Tuple(tuple) = of else { return None };
    let mut kinds = tuple.elems.iter().map(number);
    let first = kinds.next()?;
    let alike = first.is_some() && kinds.all(|kind| kind == first);
    (!alike).then_some("a tuple of more than one kind of number")
}

/// The name of a primitive type.
fn number(of: &Type) -> Option<String> {
    let Type::Path(path) = of else { return None };
    let name = path.path.get_ident()?.to_string();
    let kinds = ["u8", "u16", "u32", "u64", "u128", "usize", "i8", "i16", "i32", "i64", "i128", "isize", "f32", "f64"];
    kinds.contains(&name.as_str()).then_some(name)
}

impl<'ast> Visit<'ast> for Packed {
    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        self.check(&item.sig);
        visit::visit_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        self.check(&item.sig);
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        // What a trait asks for is asked for where the trait is.
        if item.trait_.is_none() {
            for part in &item.items {
                if let syn::ImplItem::Fn(method) = part {
                    self.check(&method.sig);
                }
            }
        }
        visit::visit_item_impl(self, item);
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !is_for_tests(&item.attrs) {
            visit::visit_item_mod(self, item);
        }
    }
}

fn offences_of(tree: &syn::File) -> Vec<String> {
    let mut packed = Packed::default();
    packed.visit_file(tree);
    packed.found
}

#[test]
fn no_parameters_are_packed_into_a_tuple() {
    let count = |text: &str| offences_of(&syn::parse_file(text).expect("Rust")).len();
    for text in [
        "fn f((a, b): (&A, &mut B)) {}",
        "fn f((x, y): (f64, f64)) {}",
        "fn f(&(x, y): &(f64, f64)) {}",
        "impl A { fn f(&self, (a, b): (A, B)) {} }",
        "trait A { fn f(&self, (a, b): (A, B)); }",
        "mod inner { fn f(ab: (A, B)) {} }",
        "fn f(pair: (&A, &B)) {}",
        "fn f(pair: &mut (A, u32)) {}",
        "fn f(pair: (u32, f32)) {}",
        "fn f() { fn inner((a, b): (A, B)) {} }",
    ] {
        assert_eq!(count(text), 1, "{text}");
    }
    for text in [
        "fn f(size_px: (u32, u32)) {}",
        "fn f(range: &(f64, f64)) {}",
        "fn f(range: Option<(f64, f64)>) {}",
        "fn f(pairs: &[(String, A)]) {}",
        "fn f(a: A, [b, c]: [B; 2]) {}",
        "fn f(nothing: ()) {}",
        "fn f() { g(|(a, b): (A, B)| a); }",
        "impl From<(A, B)> for C { fn from((a, b): (A, B)) -> Self {} }",
        "#[cfg(test)] mod tests { fn f((a, b): (A, B)) {} }",
        "fn f(by: impl Fn((A, B))) -> (A, B) {}",
    ] {
        assert_eq!(count(text), 0, "{text}");
    }
    let mut found = Vec::new();
    for path in product_files() {
        found.extend(offences_of(&parsed(&path)).into_iter().map(|why| format!("{}: {why}", name(&path))));
    }
    assert_none("every parameter has a name", &found);
}
