//! Presets of other renderers, alone and beside the renderers themselves.

mod presets;
