//! What a program needs of a Debian system, as its file says.

use std::path::Path;
use std::process::Command;

use crate::error::{Error, Result};
use crate::process::output;

/// Libraries that a program of Rust may be linked with, the packages that bring them, and how these number what they
/// offer. `dpkg-shlibdeps` would say the same, with a whole set of tools to build packages with.
const LIBRARIES: [(&str, &str, &str); 7] = [
    ("ld-linux-x86-64.so.2", "libc6", "GLIBC_"),
    ("libc.so.6", "libc6", "GLIBC_"),
    ("libdl.so.2", "libc6", "GLIBC_"),
    ("libm.so.6", "libc6", "GLIBC_"),
    ("libpthread.so.0", "libc6", "GLIBC_"),
    ("librt.so.1", "libc6", "GLIBC_"),
    ("libgcc_s.so.1", "libgcc-s1", "GCC_"),
];

/// What Debian calls the program's dependencies: packages with the oldest versions that will do.
pub(crate) fn dependencies(program: &Path) -> Result<Vec<String>> {
    let told = output(Command::new("readelf").env("LC_ALL", "C").args(["-W", "-d", "-V"]).arg(program))?;
    from_readelf(&told)
}

fn from_readelf(told: &str) -> Result<Vec<String>> {
    let mut found: Vec<String> = Vec::new();
    for name in told.lines().filter_map(library) {
        let Some((_, package, prefix)) = LIBRARIES.iter().find(|(library, ..)| *library == name) else {
            return Err(Error::Missing(format!("no package is known for the library {name}")));
        };
        let versions: Result<Vec<_>> = versions(told, prefix).map(numbers).collect();
        let dependency = match versions?.iter().max() {
            Some(newest) => format!("{package} (>= {})", dotted(newest)),
            None => (*package).to_owned(),
        };
        found.push(dependency);
    }
    if found.is_empty() {
        return Err(Error::Missing("the program names no library: is it a program for Linux?".to_owned()));
    }
    found.sort();
    found.dedup();
    Ok(found)
}

/// The name between brackets in `(NEEDED) Shared library: [NAME]`.
fn library(line: &str) -> Option<&str> {
    line.split_once("(NEEDED)")?.1.split_once('[')?.1.split_once(']').map(|(name, _)| name)
}

/// What stands behind `Name: GLIBC_` in the list of needed versions.
fn versions<'a>(told: &'a str, prefix: &str) -> impl Iterator<Item = &'a str> {
    told.lines().filter_map(move |line| {
        let name = line.split_once("Name: ")?.1.split_whitespace().next()?;
        name.strip_prefix(prefix)
    })
}

/// A version that is no number says nothing about which package will do, and must not be passed over.
fn numbers(version: &str) -> Result<Vec<u32>> {
    let parts: Option<_> = version.split('.').map(|part| part.parse().ok()).collect();
    parts.ok_or_else(|| Error::Missing(format!("the program needs a library's version {version}, which is no number")))
}

fn dotted(version: &[u32]) -> String {
    version.iter().map(u32::to_string).collect::<Vec<_>>().join(".")
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOLD: &str = "
 0x0000000000000001 (NEEDED)             Shared library: [libgcc_s.so.1]
 0x0000000000000001 (NEEDED)             Shared library: [libm.so.6]
 0x0000000000000001 (NEEDED)             Shared library: [libc.so.6]
  000000: Version: 1  File: libc.so.6  Cnt: 2
  0x0010:   Name: GLIBC_2.9  Flags: none  Version: 9
  0x0020:   Name: GLIBC_2.35  Flags: none  Version: 7
  0x0030: Version: 1  File: libgcc_s.so.1  Cnt: 1
  0x0040:   Name: GCC_4.2.0  Flags: none  Version: 3
";

    #[test]
    fn the_newest_symbol_counts() {
        assert_eq!(from_readelf(TOLD).expect("libraries"), ["libc6 (>= 2.35)", "libgcc-s1 (>= 4.2.0)"]);
    }

    #[test]
    fn what_is_not_known_is_not_passed_over() {
        let other = TOLD.replace("libm.so.6", "libopen.so.1");
        assert!(from_readelf(&other).expect_err("a library").to_string().contains("libopen.so.1"));
        let other = TOLD.replace("GLIBC_2.9", "GLIBC_ABI_DT_RELR");
        assert!(from_readelf(&other).expect_err("a version").to_string().contains("ABI_DT_RELR"));
        assert_eq!(from_readelf("").expect_err("nothing").exit_code(), 69);
    }
}
