//! Presets of other renderers, alone and beside the renderers themselves.

mod interop;
mod presets;
