//! A restricted reader of torch `.pth` files: it decodes data and can run nothing.

mod archive;
mod content;
mod flaw;
mod pickle;
mod tensor;
mod values;

pub use content::PthContent;
pub use values::{Tensor, TensorData};
