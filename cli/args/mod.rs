//! The command line: one type per subcommand, one doc comment per flag.

mod convert;
mod film;
mod pretrain;
mod study;

use std::path::PathBuf;

use bytesize::ByteSize;
use clap::{Args, Parser, Subcommand, ValueEnum};
use glam::DVec3;
use guard4d_engine::clip::Precision;
use guard4d_engine::distortion::Distortion;
use guard4d_engine::watermark::embed::Control;
use guard4d_kernels::{DeviceSelect, FamilySelect};

pub(crate) use self::convert::ConvertArgs;
pub(crate) use self::film::{FilmArgs, FrameArgs, FramingArgs};
pub(crate) use self::pretrain::PretrainArgs;
pub(crate) use self::study::{StudyArgs, StudyPart};

/// Writes an owner's message into 4D Gaussian splat assets and reads it back from rendered video.
#[derive(Debug, Parser)]
#[command(name = "guard4d", version, after_help = EXIT_CODES)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Shown below `--help`; `EngineError::exit_code` and `Outcome` give these numbers.
const EXIT_CODES: &str = "Exit codes:
  0   done; verify, demo: the mark is present
  1   verify, demo: absent; embed: the quality gate was missed (the receipt has the numbers)
  2   wrong usage
  4   verify, demo: inconclusive
  65  an input's content is wrong          66  an input is missing
  69  no suitable device or program, or    70  internal error
      too little device memory or budget
  73  an output cannot be created          74  reading or writing failed
  75  interrupted; embed left a checkpoint 76  the device was lost";

/// Flags of every subcommand.
#[derive(Args, Debug)]
pub(crate) struct Common {
    /// Vulkan device: auto, cpu, a number of `guard4d devices`, name:…, uuid:… or pci:…
    ///
    /// `auto` takes the GPU that a scheduler assigned (CUDA_VISIBLE_DEVICES, ROCR_VISIBLE_DEVICES, HIP_VISIBLE_DEVICES,
    /// GPU_DEVICE_ORDINAL, SLURM_JOB_GPUS, CUE_GPU_CORES, PARALLEL_JOBSLOT: numbers in PCI order, or a UUID), else the only
    /// GPU, else the processor. `guard4d devices` marks the one that it takes.
    #[arg(long, global = true, default_value = "auto", env = "GUARD4D_DEVICE")]
    pub(crate) device: DeviceSelect,
    /// Kernels to run on it: auto, lanes (for processors) or tiles (for GPUs; runs everywhere)
    ///
    /// `auto` takes lanes on a processor whose driver can run them, tiles elsewhere. Both compute the same up to rounding.
    #[arg(long, global = true, default_value = "auto", env = "GUARD4D_KERNELS")]
    pub(crate) kernels: FamilySelect,
    /// How the matrices of CLIP's image tower are kept: f32, or fixed16 or f16, which take half the memory and are faster
    ///
    /// An element of a fixed16 row is off by at most 2⁻¹⁶ of the row's largest. f16 is for GPUs with cooperative matrices
    /// (`guard4d devices` says which): all factors of a product are off by up to 2⁻¹¹ of themselves. Keys do not depend on
    /// either.
    #[arg(long, global = true, default_value_t, value_name = "PRECISION")]
    pub(crate) precision: Precision,
    /// Most device memory to take, such as 512MiB or 4GB; `embed` then keeps fewer clips at hand, to the same result
    #[arg(long, global = true, value_name = "SIZE", env = "GUARD4D_VRAM_BUDGET")]
    pub(crate) vram_budget: Option<ByteSize>,
    /// Print results as JSON on stdout
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// More talk on stderr; twice for every dispatch
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub(crate) verbose: u8,
    /// No progress bar and no notes on stderr
    #[arg(short, long, global = true)]
    pub(crate) quiet: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Marks the embedded scene, renders it to 8-bit video and reads the mark back
    Demo(DemoArgs),
    /// Makes an owner key: token table and message decoder, derived from a master secret
    Keygen(KeygenArgs),
    /// Makes a general extractor from random scenes and offsets: nobody's key or message takes part
    PretrainExtractor(PretrainArgs),
    /// Writes a message into a model, or takes it out again with --undo
    ///
    /// Training takes views of its own: all around --target and looking at it, --radius away, at random heights above the
    /// horizon (`elevation_deg` in the receipt), with --fov and --size. A part of the scene that
    /// they do not see is not marked. --cameras, or --orbit with --elevation and --frames, only say where the result is
    /// measured.
    Embed(Box<EmbedArgs>),
    /// Reads a mark from video and says how sure that is
    Verify(VerifyArgs),
    /// Renders a model to 8-bit frames or a video
    Render(RenderArgs),
    /// Distorts a film as copies are distorted, to see what `verify` then reads
    Attack(AttackArgs),
    /// Writes a model, or a moment of a moving one, as a file for other programs
    Convert(ConvertArgs),
    /// Measures how well marks are read, what they cost and where that fails; writes CSV, JSON, SVG and a page for each part
    ///
    /// Readings are kept in OUT/readings.csv as soon as they are made; the same command goes on where it was. Nothing
    /// is measured twice that several parts need.
    Study(StudyArgs),
    /// Says what a model, key or receipt holds
    Inspect(InspectArgs),
    /// Lists the Vulkan devices
    Devices,
    /// Runs one operation from a file to a file, for comparison with other implementations
    Dump(DumpArgs),
}

#[derive(Args, Debug)]
pub(crate) struct DemoArgs {
    /// Folder for frames, videos, key and receipt
    #[arg(long, default_value = "guard4d-demo")]
    pub(crate) out: PathBuf,
    /// Replace what is there
    #[arg(short = 'w', long)]
    pub(crate) overwrite: bool,
    /// Seed of cameras and noise
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    #[command(flatten)]
    pub(crate) short: ShortDemoArgs,
}

/// For a demonstration that proves nothing but ends soon, as tests need it; `--help` does not show them.
#[derive(Args, Debug)]
#[command(mut_arg("steps", |arg| arg.hide(true)))]
#[command(mut_arg("train_clips", |arg| arg.hide(true)))]
#[command(mut_arg("responses", |arg| arg.hide(true)))]
pub(crate) struct ShortDemoArgs {
    #[command(flatten)]
    pub(crate) effort: EffortArgs,
    /// Picture size WIDTHxHEIGHT
    #[arg(long, hide = true, value_parser = parse_size)]
    pub(crate) size: Option<(u32, u32)>,
    /// Film this many of the frames that training never saw instead of all
    #[arg(long, hide = true)]
    pub(crate) frames: Option<usize>,
    /// Owner key instead of a fresh one
    #[arg(long, hide = true)]
    pub(crate) key: Option<PathBuf>,
    /// Wrong key instead of a fresh one
    #[arg(long, hide = true)]
    pub(crate) wrong_key: Option<PathBuf>,
}

/// How much an embedding is trained.
#[derive(Args, Debug)]
pub(crate) struct EffortArgs {
    /// Training steps instead of the profile's
    #[arg(long)]
    pub(crate) steps: Option<u32>,
    /// Training clips instead of the profile's
    #[arg(long)]
    pub(crate) train_clips: Option<u32>,
    /// Random offset fields that the calibration is fitted to, instead of the profile's
    #[arg(long)]
    pub(crate) responses: Option<u32>,
    /// Mixings of the key that are tried before the best for the message is taken, with `blind` and `general`; every
    /// p-value is multiplied by them
    #[arg(long, value_name = "K")]
    pub(crate) mixings: Option<u32>,
}

#[derive(Args, Debug)]
pub(crate) struct KeygenArgs {
    /// CLIP checkpoint: `mini` (embedded) or a folder with config.json and model.safetensors
    #[arg(long, default_value = "mini")]
    pub(crate) clip: String,
    /// Message bits: a multiple of 8, and at most two less than the CLIP model has text positions (`mini`: 72)
    #[arg(long, default_value_t = 16)]
    pub(crate) bits: u32,
    /// Key file to write; keep it private
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// File with a 64-digit hex master secret, instead of a fresh random one
    #[arg(long)]
    pub(crate) secret: Option<PathBuf>,
    /// Replace an existing key
    #[arg(short = 'w', long)]
    pub(crate) overwrite: bool,
}

/// Width and height of pictures when nothing says otherwise, px.
const DEFAULT_SIZE: (u32, u32) = (400, 400);

/// Where the views of a rendering come from.
#[derive(Args, Debug)]
pub(crate) struct ViewArgs {
    /// Camera file or folder: transforms JSON (D-NeRF, Blender, nerfstudio), cameras.json (INRIA), camera_path.json
    /// (nerfstudio), a COLMAP folder (text or binary; itself or with sparse/0) or a Nerfies/HyperNeRF folder
    ///
    /// The content tells which. Where it has no times, as COLMAP and INRIA, --frames spreads frames over the motion. Lens
    /// distortion is refused: undistort first; of Nerfies cameras it is ignored, as 4DGaussians does.
    #[arg(long, value_name = "PATH", conflicts_with = "orbit")]
    pub(crate) cameras: Option<PathBuf>,
    /// Film this many frames on a smooth flight through --cameras in their order, while time runs from 0 to 1
    #[arg(long, value_name = "FRAMES", requires = "cameras")]
    pub(crate) interpolate: Option<u32>,
    /// Let the flight come back to its first camera, so that the film can be repeated
    #[arg(long, requires = "interpolate")]
    pub(crate) closed: bool,
    /// This many views on a circle around the scene instead
    #[arg(long)]
    pub(crate) orbit: Option<u32>,
    /// Elevation of the orbit in degrees above the horizon
    #[arg(long, default_value_t = 30.0, allow_negative_numbers = true)]
    pub(crate) elevation: f32,
    /// Radius of the orbit in scene units; unless given, 4 for a moving model, and as far as fills the frame for a static one
    #[arg(long)]
    pub(crate) radius: Option<f64>,
    /// Point that the orbit is around; unless given, the origin for a moving model, and the middle of the splats of a static one
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub(crate) target: Option<DVec3>,
    /// Horizontal field of view of the orbit in degrees
    #[arg(long, default_value_t = 39.6)]
    pub(crate) fov: f32,
    /// Frames per view of the orbit, and of cameras without times, spread over the whole motion
    #[arg(long, default_value_t = 8)]
    pub(crate) frames: u32,
    /// Picture size WIDTHxHEIGHT [default: what --cameras says, or 400x400]
    ///
    /// What --cameras shows is scaled to it, and stretched if its shape is another.
    #[arg(long, value_parser = parse_size)]
    pub(crate) size: Option<(u32, u32)>,
}

impl ViewArgs {
    /// Width and height in px of what has no size of its own.
    pub(crate) fn size(&self) -> (u32, u32) {
        self.size.unwrap_or(DEFAULT_SIZE)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProfileArg {
    /// Fast and coarse, for a first look
    Draft,
    /// The default
    Balanced,
    /// The paper's objective and weights, for comparison; takes --extractor joint unless told otherwise
    Faithful,
    /// The paper's single-frame baseline (GuardSplat): its objective, --extractor none
    Guardsplat,
    /// The paper's multi-frame baseline: the same on clips of one camera
    MultiFrame,
}

/// The objective, where it is to differ from the profile's.
#[derive(Args, Debug)]
#[command(next_help_heading = "Objective (instead of the profile's)")]
pub(crate) struct ObjectiveArgs {
    /// Weight of the message loss and its controls (paper: 0.03)
    #[arg(long, value_name = "WEIGHT")]
    pub(crate) lambda_msg: Option<f32>,
    /// Weight of L1 and 1 - SSIM (paper: 1)
    #[arg(long, value_name = "WEIGHT")]
    pub(crate) lambda_recon: Option<f32>,
    /// Share of SSIM in that (paper: 0.2)
    #[arg(long, value_name = "SHARE")]
    pub(crate) lambda_ssim: Option<f32>,
    /// Weight of the offset penalty (paper: 10)
    #[arg(long, value_name = "WEIGHT")]
    pub(crate) lambda_offset: Option<f32>,
    /// Weight of the control losses against the message loss
    #[arg(long, value_name = "WEIGHT")]
    pub(crate) lambda_control: Option<f32>,
    /// Control loss of `joint`: inverse-bce:EPS (paper), hinge:EPS or chance
    #[arg(long, value_name = "LOSS")]
    pub(crate) control: Option<Control>,
    /// Adam's rate for DC offsets (paper: 0.005)
    #[arg(long, value_name = "RATE")]
    pub(crate) lr_dc: Option<f32>,
    /// Rate of the other offsets as a share of that (paper: 0.05)
    #[arg(long, value_name = "SHARE")]
    pub(crate) lr_rest_share: Option<f32>,
    /// Share of the rates that is left at the end of their cosine; 1 keeps them constant (paper)
    #[arg(long, value_name = "SHARE")]
    pub(crate) lr_floor: Option<f32>,
    /// Logit beyond which a bit is left alone; 0 takes the paper's cross-entropy
    #[arg(long, value_name = "LOGIT")]
    pub(crate) margin: Option<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FitArg {
    /// Begin with the splats that carry most of the light and half of the views; take all when clips that training never
    /// sees show no more progress. Stop when each of them proves the message alone, by a margin, or when they show no
    /// progress then either. The extractor stays what it is: `joint` gives no exact p-value, and is never chosen for you
    Auto,
    /// Take all steps of the profile on everything: the strongest mark
    Full,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExtractorArg {
    /// CLIP and the decoder alone: exact p-values
    None,
    /// A front end that never saw the message: exact p-values
    Blind,
    /// The same, with directions learned once from other scenes, before anyone had this one: exact p-values
    General,
    /// The paper's front end, trained with the message: only empirical false-positive rates
    Joint,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BasesArg {
    /// The base colour alone: survives formats that drop the rest
    Dc,
    /// Every coefficient of the model's degree: the mark then also turns with the view
    All,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LpipsInputArg {
    /// Colours in [-1, 1], as LPIPS is defined
    Canonical,
    /// Colours in [0, 1], as much of the literature on splats feeds it; its figures are others
    Unit,
}

/// LPIPS beside PSNR and SSIM.
#[derive(Args, Debug)]
pub(crate) struct LpipsArgs {
    /// LPIPS weights, version 0.1 for AlexNet or VGG16, as safetensors: report LPIPS, and train with it if --lambda-lpips says so
    #[arg(long, value_name = "FILE")]
    pub(crate) lpips: Option<PathBuf>,
    /// Weight of LPIPS in the loss; 0 only reports it
    #[arg(long, value_name = "WEIGHT", default_value_t = 0.0, requires = "lpips")]
    pub(crate) lambda_lpips: f32,
    /// Range in which LPIPS is given colours
    #[arg(long, value_enum, default_value = "canonical", requires = "lpips")]
    pub(crate) lpips_input: LpipsInputArg,
    /// Train LPIPS on a square part of the frames of this side, another in every step, instead of whole frames: faster
    #[arg(long, value_name = "PX", requires = "lpips")]
    pub(crate) lpips_crop: Option<u32>,
    /// Train LPIPS in every K-th step only, and count it K times: faster, less exact
    #[arg(long, value_name = "K", default_value_t = 1, requires = "lpips")]
    pub(crate) lpips_every: u32,
}

#[derive(Args, Debug)]
pub(crate) struct EmbedArgs {
    /// Model, as `inspect` can read it: a folder, or a file of splats; with --undo the marked one
    pub(crate) model: PathBuf,
    /// Owner key
    #[arg(long, required_unless_present = "undo")]
    pub(crate) key: Option<PathBuf>,
    /// CLIP checkpoint that the key was made with: `mini` or a folder
    #[arg(long, default_value = "mini")]
    pub(crate) clip: String,
    /// hex:…, bits:…, id:12:N or id:16:N (a number that survives wrong bits), or random: the key's own message, the
    /// same in every model
    #[arg(long, default_value = "random")]
    pub(crate) message: String,
    #[command(flatten)]
    pub(crate) views: ViewArgs,
    /// Folder for the marked model, the private files and a preview
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Write a marked SPZ as SPZ, whose colours are rounded, instead of as PLY; what is judged is the mark that is left
    #[arg(long, conflicts_with = "undo")]
    pub(crate) lossy: bool,
    /// Write nothing: say how much device memory and time this would take, after trying a few clips and steps
    #[arg(long, conflicts_with_all = ["undo", "resume"])]
    pub(crate) dry_run: bool,
    /// How much work to spend
    #[arg(long, value_enum, default_value = "balanced")]
    pub(crate) profile: ProfileArg,
    /// Whether to do no more than the scene needs
    #[arg(long, value_enum, default_value = "full")]
    pub(crate) fit: FitArg,
    /// What a frame passes through before CLIP, and so what a match proves
    ///
    /// By default `blind`; with the paper's profiles what they are about.
    #[arg(long, value_enum)]
    pub(crate) extractor: Option<ExtractorArg>,
    /// General extractor for `--extractor general`, as `pretrain-extractor` writes it; one for `mini` is built in
    #[arg(long, value_name = "FILE")]
    pub(crate) general: Option<PathBuf>,
    /// Let `joint` read an unmarked control clip on every K-th step only, and count it K times: faster, less exact
    #[arg(long, value_name = "K", default_value_t = 1)]
    pub(crate) control_every: u32,
    /// Share of the steps in which the extractor of `joint` stays as it was fitted, at the start [default: 0.5; with the
    /// paper's profiles 0]
    #[arg(long, value_name = "SHARE")]
    pub(crate) tmsd_held: Option<f32>,
    #[command(flatten)]
    pub(crate) objective: ObjectiveArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
    /// Train on distorted frames too: each of these as often as undistorted ones, as `guard4d attack --help` names them
    ///
    /// Strengths of noise, rotation, crop and brightness can be drawn between two numbers: rotation:-15..15.
    #[arg(long = "distort", value_name = "NAME:STRENGTH", value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) distortions: Vec<Distortion>,
    #[command(flatten)]
    pub(crate) effort: EffortArgs,
    /// Fidelity to hold at least, in dB over whole frames, instead of the profile's; marks are as strong as it allows, to
    /// within a few dB
    #[arg(long)]
    pub(crate) target_psnr: Option<f32>,
    /// Quality gate: least share of bits right on unseen clips, 0 to 1, instead of what it asks for by default: that half
    /// of these clips each prove the message alone
    #[arg(long, value_name = "SHARE")]
    pub(crate) min_accuracy: Option<f64>,
    /// Quality gate: least PSNR of whole unseen frames in dB; by default none
    #[arg(long, value_name = "DB")]
    pub(crate) min_psnr: Option<f64>,
    /// SH coefficients to write into, by default `all`
    #[arg(long, value_enum)]
    pub(crate) bases: Option<BasesArg>,
    /// Most that an offset may be, as a change of its splat's colour from 0 to 1: less is harder to see, and survives less
    ///
    /// Where not all 16 coefficients of degree 3 have offsets, they may be larger by the root of 16 over their number.
    #[arg(long, value_name = "COLOUR")]
    pub(crate) max_offset: Option<f32>,
    /// Change only the splats that together carry this share of the light in the training views: 1 all, 0.9 far fewer
    #[arg(long, value_name = "SHARE")]
    pub(crate) reach: Option<f32>,
    /// Seed of cameras and noise
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Write a checkpoint this often, in seconds
    #[arg(long, default_value_t = 60)]
    pub(crate) checkpoint_every: u64,
    /// Go on from the checkpoint of an interrupted run with the same arguments
    #[arg(long)]
    pub(crate) resume: bool,
    /// Restore the original from a marked model and this private undo.safetensors
    #[arg(long, value_name = "FILE")]
    pub(crate) undo: Option<PathBuf>,
    /// Replace what is there
    #[arg(short = 'w', long)]
    pub(crate) overwrite: bool,
}

#[derive(Args, Debug)]
pub(crate) struct VerifyArgs {
    /// Folders of PNG, JPEG or OpenEXR frames, or video files; too few frames in all, such as a single one, end inconclusive
    #[arg(required = true)]
    pub(crate) clips: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) frames: FrameArgs,
    #[command(flatten)]
    pub(crate) framing: FramingArgs,
    /// Owner key
    #[arg(long)]
    pub(crate) key: PathBuf,
    /// CLIP checkpoint that the key was made with: `mini` or a folder
    #[arg(long, default_value = "mini")]
    pub(crate) clip: String,
    /// Receipt of the embedding; its folder holds the extractor
    #[arg(long)]
    pub(crate) receipt: PathBuf,
    /// General extractor that `embed` was given, if it was not the built-in one
    #[arg(long, value_name = "FILE")]
    pub(crate) general: Option<PathBuf>,
    /// The message claimed, as it was given to `embed`; id:12 or id:16 reads whichever number is there
    ///
    /// By default what the receipt says: whichever number is there, or the key's own message. A number that is read and
    /// not claimed could have been any, and its p-value is multiplied by how many there are.
    #[arg(long)]
    pub(crate) message: Option<String>,
    /// The unmarked model, when the owner has it: its clean render is a control
    #[arg(long)]
    pub(crate) original: Option<PathBuf>,
    /// Views of the unmarked model's control clips
    #[command(flatten)]
    pub(crate) views: ViewArgs,
    /// Clips that surely carry no mark, as further controls
    #[arg(long)]
    pub(crate) unrelated: Vec<PathBuf>,
    /// Keys of others, as long as the owner's: each must not find its own message
    #[arg(long)]
    pub(crate) other_key: Vec<PathBuf>,
}

#[derive(Args, Debug)]
pub(crate) struct RenderArgs {
    /// Model, as `inspect` can read it: a folder, or a file of splats
    pub(crate) model: PathBuf,
    #[command(flatten)]
    pub(crate) views: ViewArgs,
    #[command(flatten)]
    pub(crate) film: FilmArgs,
}

#[derive(Args, Debug)]
pub(crate) struct AttackArgs {
    /// Folder of PNG, JPEG or OpenEXR frames, or video file
    pub(crate) clip: PathBuf,
    #[command(flatten)]
    pub(crate) frames: FrameArgs,
    /// What to do to every frame, one after the other, each with a rounding to 8 bits: NAME:STRENGTH
    ///
    /// noise (standard deviation, colours being in [0, 1]), rotation (degrees, black outside), rescale (share of each side, and
    /// back), blur (standard deviation in px), crop (share of each side that is kept and enlarged), brightness (factor), jpeg
    /// (quality), codec (low pass in px with chroma at half resolution; --out FILE.mp4 --crf is a real codec), mirror, identity.
    #[arg(long = "with", value_name = "NAME:STRENGTH", value_delimiter = ',', required = true)]
    pub(crate) distortions: Vec<Distortion>,
    /// Seed of noise
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    #[command(flatten)]
    pub(crate) film: FilmArgs,
}

/// Parts of a study.
#[derive(Args, Debug)]
pub(crate) struct InspectArgs {
    /// Model folder or file, key (with how many bits have to match) or receipt
    pub(crate) path: PathBuf,
}

#[derive(Args, Debug)]
pub(crate) struct DumpArgs {
    #[command(subcommand)]
    pub(crate) command: DumpCommand,
    /// Replace what is there
    #[arg(short = 'w', long, global = true)]
    pub(crate) overwrite: bool,
}

#[derive(Debug, Subcommand)]
pub(crate) enum DumpCommand {
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
        border: BorderArg,
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
        #[arg(long, value_parser = parse_any_size)]
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

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BorderArg {
    /// Zeros
    Zero,
    /// Nearest frame in time, mirrored in space: what the extractor uses
    Clip,
}

/// Input and output of a dump.
#[derive(Args, Debug)]
pub(crate) struct DumpIo {
    /// safetensors file to read
    #[arg(long)]
    pub(crate) input: PathBuf,
    /// safetensors file to write
    #[arg(long)]
    pub(crate) out: PathBuf,
}

/// A point of the scene.
fn parse_point(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|n| n.is_finite()) => Ok(DVec3::new(x, y, z)),
        _ => Err(format!("`{text}`: expected three numbers, X,Y,Z")),
    }
}

/// Size of a picture.
fn parse_size(text: &str) -> Result<(u32, u32), String> {
    size_within(text, 16..=8192)
}

/// Size of any clip that a file may hold.
fn parse_any_size(text: &str) -> Result<(u32, u32), String> {
    size_within(text, 1..=8192)
}

fn size_within(text: &str, sides: std::ops::RangeInclusive<u32>) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let fits = parsed.filter(|(w, h)| sides.contains(w) && sides.contains(h));
    fits.ok_or_else(|| format!("`{text}`: expected WIDTHxHEIGHT, each from {} to {}", sides.start(), sides.end()))
}
