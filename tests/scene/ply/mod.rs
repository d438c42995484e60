//! PLY files: read by property name, and written back byte for byte.

mod compressed;
mod file;
pub(crate) mod paths;
