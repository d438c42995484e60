//! PLY files of splats, as trainers write them and as `SuperSplat` compresses them.

mod body;
mod compressed;
mod file;
mod header;
mod paths;

pub use compressed::CompressedPlyFile;
pub(super) use compressed::{decode_compressed, is_compressed};
pub use file::{PlyFile, encode};
