//! Arguments of `guard4d pretrain-extractor`.

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::watermark::embed::pretrain::Scenery;
use guard4d_engine::watermark::message::MAX_MESSAGE_BITS;

#[derive(Args, Debug)]
pub(crate) struct PretrainArgs {
    /// CLIP checkpoint: `mini` (embedded) or a folder with config.json and model.safetensors
    #[arg(long, default_value = "mini")]
    pub(crate) clip: String,
    /// Scenes to learn from: `procedural:N` for N of random shapes and textures, and models
    #[arg(long, value_delimiter = ',', default_value = "procedural:96")]
    pub(crate) scenes: Vec<Scenery>,
    /// Scenes that the learning curve is about, and that are not learned from
    #[arg(long, value_delimiter = ',', default_value = "procedural:3")]
    pub(crate) probes: Vec<Scenery>,
    /// Most bits of a message that it can read; `mini` has keys of at most 72
    #[arg(long, default_value_t = 72, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_MESSAGE_BITS)))]
    pub(crate) bits: u32,
    /// Extractor file to write; the learning curve goes beside it, with the extension csv
    ///
    /// An interrupted run leaves a checkpoint beside it, from which the same command goes on with --resume.
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Public seed of scenes, views and offsets
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Clips of each scene
    #[arg(long, default_value_t = 24)]
    pub(crate) train_clips: u32,
    /// Random offset fields on each scene
    #[arg(long, default_value_t = 32)]
    pub(crate) responses: u32,
    /// Side of the frames in pixels
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub(crate) size: u32,
    /// Go on from the checkpoint of an interrupted run
    #[arg(long)]
    pub(crate) resume: bool,
    /// Replace an existing file
    #[arg(short = 'w', long)]
    pub(crate) overwrite: bool,
}
