//! `guard4d lab dump`

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::scene::Model;
use serde_json::json;

use super::host::Host;
use crate::dump::{self, Border, View};

#[derive(Args, Debug)]
pub(super) struct DumpArgs {
    #[command(subcommand)]
    command: DumpCommand,
    /// Replace what is there
    #[arg(short = 'w', long, global = true)]
    overwrite: bool,
}

#[derive(Debug, Subcommand)]
enum DumpCommand {
    /// Deformed splats of a model at one time, before activation
    ///
    /// Writes xyz [N,3], scale [N,3], rot [N,4], opacity [N,1] and sh [N,16,3]; of a moving model also
    /// feat [N,levels*channels] and hidden [N,width].
    Deform {
        /// Model, as `inspect` can read it: a folder, or a file of splats
        model: PathBuf,
        /// Time from 0 to 1
        #[arg(long)]
        time: f32,
        /// safetensors file to write
        #[arg(long)]
        out: PathBuf,
    },
    /// Picture, transmittance and SH gradient of one view
    ///
    /// Writes image [H,W,3] (not clamped) and final_T [H,W]; with --v-image also dL_dsh [N,16,3].
    Render {
        /// Model, as `inspect` can read it: a folder, or a file of splats
        model: PathBuf,
        /// JSON with width, height, fx, fy and world_to_camera_row_major; background and time if wanted
        #[arg(long)]
        camera: PathBuf,
        /// Time from 0 to 1 instead of the camera's
        #[arg(long)]
        time: Option<f32>,
        /// safetensors file with dL_dimage [H,W,3]
        #[arg(long)]
        v_image: Option<PathBuf>,
        /// safetensors file to write
        #[arg(long)]
        out: PathBuf,
    },
    /// CLIP features and the gradient of the pixels
    ///
    /// Reads pixel_values [B,3,S,S] (normalised), input_ids [T,77] and v_image_embeds [G,D] (gradient of the first G
    /// images' features), each if it is there. Writes image_embeds [B,D] and text_embeds [T,D] of unit length, and
    /// v_pixel_values [G,3,S,S].
    Clip {
        /// CLIP checkpoint: `mini` (embedded) or a folder with config.json and model.safetensors
        #[arg(long, default_value = "mini")]
        clip: String,
        #[command(flatten)]
        io: DumpIo,
    },
    /// 3x3x3 convolution and its gradients
    ///
    /// Reads x [F,H,W,Ci] and weight [Co,Ci,3,3,3], and bias [Co] and v_y [F,H,W,Co] if they are there. Writes
    /// y [F,H,W,Co]; with v_y also v_x, v_weight and v_bias.
    Conv3d {
        /// What lies outside the clip
        #[arg(long, value_enum, default_value = "clip")]
        border: Border,
        #[command(flatten)]
        io: DumpIo,
    },
    /// Mean SSIM of a clip and its gradient
    ///
    /// Reads x and y [F,H,W,C] with C = 3 or 4, the fourth channel unread. Writes value [1] and v_x like x.
    Ssim {
        #[command(flatten)]
        io: DumpIo,
    },
    /// Antialiased bilinear resize with aligned corners, and its gradient
    ///
    /// Reads x [F,H,W,C] with C = 3 or 4, the fourth channel unread, and v_y [F,h,w,C] if it is there. Writes
    /// y [F,h,w,C]; with v_y also v_x like x.
    Resize {
        /// Size to come to: WIDTHxHEIGHT, that is wxh
        #[arg(long, value_parser = parse_size)]
        size: (u32, u32),
        #[command(flatten)]
        io: DumpIo,
    },
    /// Adam steps on given gradients
    ///
    /// Reads param [n], grads [steps,n] and hyper [4] (learning rate, decays of both moments, epsilon). Writes
    /// history [steps,n] (the parameters after each step), and the last moments exp_avg [n] and exp_avg_sq [n].
    Adam {
        #[command(flatten)]
        io: DumpIo,
    },
}

/// Input and output of a dump.
#[derive(Args, Debug)]
struct DumpIo {
    /// safetensors file to read
    #[arg(long)]
    input: PathBuf,
    /// safetensors file to write
    #[arg(long)]
    out: PathBuf,
}

pub(super) fn run(args: &DumpArgs, host: &dyn Host) -> Result<(), EngineError> {
    let device = host.open()?;
    let (tensors, out) = match &args.command {
        DumpCommand::Deform { model, time, out } => (dump::deform(&device, &Model::open(model)?, *time)?, out),
        DumpCommand::Render { model, camera, time, v_image, out } => {
            let view = View::open(camera, *time)?;
            let v_image = v_image.as_deref().map(TensorFile::read).transpose()?;
            (dump::render(&device, &Model::open(model)?, &view, v_image.as_ref())?, out)
        }
        DumpCommand::Clip { clip, io } => {
            let clip = ClipModel::load(&device, &ClipSource::from_argument(clip))?.in_precision(host.precision());
            (dump::clip(&device, &clip, &TensorFile::read(&io.input)?)?, &io.out)
        }
        DumpCommand::Conv3d { border, io } => (dump::conv3d(&device, &TensorFile::read(&io.input)?, *border)?, &io.out),
        DumpCommand::Ssim { io } => (dump::ssim(&device, &TensorFile::read(&io.input)?)?, &io.out),
        DumpCommand::Resize { size: (width, height), io } => {
            let to = [*height, *width].map(|side| side as usize);
            (dump::resize(&device, &TensorFile::read(&io.input)?, to)?, &io.out)
        }
        DumpCommand::Adam { io } => (dump::adam(&device, &TensorFile::read(&io.input)?)?, &io.out),
    };
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    write(&tensors, out, existing, host)
}

/// Writes the tensors and names them with their shapes.
fn write(tensors: &TensorFile, out: &Path, existing: Existing, host: &dyn Host) -> Result<(), EngineError> {
    AtomicFile::write(out, existing, &tensors.to_bytes()?)?;
    let shapes: serde_json::Map<_, _> = tensors.tensors.iter().map(|(n, t)| (n.clone(), json!(t.shape))).collect();
    let words: Vec<String> = shapes.iter().map(|(name, shape)| format!("  {name} {shape}")).collect();
    host.print(&json!(shapes), &words.join("\n"))
}

/// Longest side of a clip that a file may hold, px.
const MAX_SIDE_PX: u32 = 8192;

/// Width and height of a clip.
fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let fits = parsed.filter(|(w, h)| (1..=MAX_SIDE_PX).contains(w) && (1..=MAX_SIDE_PX).contains(h));
    fits.ok_or_else(|| format!("`{text}`: expected WIDTHxHEIGHT, each from 1 to {MAX_SIDE_PX}"))
}
