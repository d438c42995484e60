//! Arguments of `convert`.

use std::path::PathBuf;

use clap::Args;

use super::ViewArgs;

#[derive(Args, Debug)]
pub(crate) struct ConvertArgs {
    /// Model: whatever `inspect` can read
    pub(crate) model: PathBuf,
    /// File to write: .ply and .glb keep every coefficient to the bit, .spz rounds them; with --moments a folder of PLYs
    pub(crate) out: PathBuf,
    /// Moment of a moving model, 0 to 1
    #[arg(long, default_value_t = 0.0, value_name = "T", conflicts_with = "moments")]
    pub(crate) time: f32,
    /// A PLY for each of this many moments, spread over the whole motion, instead of one file
    #[arg(long, value_name = "N")]
    pub(crate) moments: Option<u32>,
    /// Write a format that rounds colours, which can cost bits of a mark
    #[arg(long)]
    pub(crate) lossy: bool,
    /// Owner key: read the mark from pictures of what was written, and say what is left of it
    #[arg(long, requires = "receipt")]
    pub(crate) key: Option<PathBuf>,
    /// Receipt of the embedding; its folder holds the extractor
    #[arg(long, requires = "key")]
    pub(crate) receipt: Option<PathBuf>,
    /// The message to look for, as it was given to `embed`; by default what the receipt says, as for `verify`
    #[arg(long, requires = "key")]
    pub(crate) message: Option<String>,
    /// General extractor that `embed` was given, if it was not the built-in one
    #[arg(long, value_name = "FILE", requires = "key")]
    pub(crate) general: Option<PathBuf>,
    /// CLIP checkpoint that the key was made with: `mini` or a folder
    #[arg(long, default_value = "mini", requires = "key")]
    pub(crate) clip: String,
    /// Views of these pictures
    #[command(flatten)]
    pub(crate) views: ViewArgs,
    /// Replace what is there
    #[arg(long)]
    pub(crate) overwrite: bool,
}
