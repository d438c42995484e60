//! glTF binaries with `KHR_gaussian_splatting` (Khronos): every value has an accessor of its own. Coefficients are
//! always floats, so that new ones can be written in place.

mod document;
mod encode;
mod file;
mod reader;

pub(super) use document::MAGIC;
pub use encode::encode;
pub use file::GlbFile;
