//! `guard4d verify`

use std::num::NonZeroU32;
use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::detect::controls::OtherKey;
use guard4d_engine::detect::request::{VerifyInputs, VerifyRequest};
use guard4d_engine::detect::sought::Sought;
use guard4d_engine::error::EngineError;
use guard4d_engine::media::ReadOptions;
use guard4d_engine::release::dating::standing::DateFiles;
use guard4d_engine::release::receipt::Receipt;
use guard4d_engine::render::render_frames;
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;

use crate::flags::common::Common;
use crate::flags::frames::{FrameArgs, FramingArgs};
use crate::flags::near::NearArgs;
use crate::flags::overwrite::Overwrite;
use crate::flags::passphrase::PassphraseArgs;
use crate::flags::trust::TrustArgs;
use crate::flags::views::EvaluationViews;
use crate::shared::farm_job::FarmJob;
use crate::shared::media::read_some;
use crate::shared::views::cameras;
use crate::shared::{device, locator, suspects};
use crate::ui::document::{Document, Repeat};
use crate::ui::outcome::Outcome;
use crate::ui::progress::ObserverBar;
use crate::ui::report::print;
use crate::ui::stop;
use crate::ui::verification::human;

/// What is suspected, by whom, and what it is compared with.
#[derive(Args, Debug)]
#[command(mut_arg("near", |near| near.conflicts_with("cameras")))]
pub(crate) struct VerifyArgs {
    /// Videos, folders of PNG, JPEG or OpenEXR frames, or models; their content tells which
    ///
    /// All of them are read as one. Too few frames in all, such as a single one, end inconclusive. A model is rendered
    /// to 8-bit frames and read as a film of these.
    #[arg(required = true, value_name = "SUSPECT")]
    suspects: Vec<PathBuf>,
    /// Owner key, or the key of the asset that its owner disclosed
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    #[command(flatten)]
    passphrase: PassphraseArgs,
    /// Receipt of the embedding; its folder holds the extractor
    #[arg(long, value_name = "FILE")]
    receipt: PathBuf,
    /// The message claimed, as it was given to `embed` [default: what the receipt says]
    ///
    /// id:12 or id:16 reads whichever number is there, and so does the default where the receipt is for a number; else
    /// it is the key's own message. A number that is read and not claimed could have been any, and its p-value is
    /// multiplied by how many there are.
    #[arg(long)]
    message: Option<String>,
    /// CLIP checkpoint that the key was made with: `mini` or a folder
    #[arg(long, default_value = "mini")]
    clip: String,
    /// Pretrained extractor that `embed` was given, if it was not the built-in one
    #[arg(long, value_name = "FILE")]
    pretrained: Option<PathBuf>,
    /// How many receipts, keys, owners, films or readings this claim was chosen from; multiplies every p-value
    ///
    /// Whoever tries a film with ten receipts, or ten crops of it with one, has ten chances. A number that is too small
    /// makes the p-value wrong.
    #[arg(long, value_name = "N", default_value = "1")]
    claims: NonZeroU32,
    /// CLIP checkpoint that somebody other than the owner published, by the hash that `verify` names
    ///
    /// Only the program's own is taken as it is: whoever makes a checkpoint could make it read a message anywhere.
    #[arg(long, value_name = "HASH", value_parser = parse_digest)]
    trust_clip: Option<Digest>,
    /// The unmarked model, when the owner has it: its clean render is a control, and the extractor is fitted again
    ///
    /// An extractor that does not follow from it is refused. Fitting takes about as long as it took `embed`. Suspect
    /// models are then filmed as it is: around the same point, over the same background.
    #[arg(long, value_name = "MODEL", help_heading = "Controls")]
    original: Option<PathBuf>,
    /// A clip that surely carries no mark, as a further control
    #[arg(long, value_name = "CLIP", help_heading = "Controls")]
    unrelated: Vec<PathBuf>,
    /// Key of somebody else, as long as the owner's: it must not find its own message
    #[arg(long, value_name = "FILE", help_heading = "Controls")]
    other_key: Vec<PathBuf>,
    /// Root or proof of `commit` that the receipt is under [default: receipt.proof.json, if it lies beside the receipt]
    ///
    /// Any receipt of the root could have been the one that fits, so that every p-value is multiplied by their number.
    #[arg(long, value_name = "FILE", help_heading = "Date")]
    root: Option<PathBuf>,
    /// Time-stamp token of the receipt or of its root [default: the .tst file beside either]
    #[arg(long, value_name = "FILE", help_heading = "Date")]
    timestamp: Option<PathBuf>,
    #[command(flatten)]
    trust: TrustArgs,
    #[command(flatten)]
    frames: FrameArgs,
    #[command(flatten)]
    framing: FramingArgs,
    #[command(flatten)]
    views: EvaluationViews,
    /// The film was taken by the cameras of --cameras or --orbit: its frames are cut to what training showed as these
    /// say, and not by what they look like
    ///
    /// There have to be as many of them as frames are read, view by view as `render` films them, or one. Cameras that
    /// were tried until the film read best have to be counted by --claims.
    #[arg(long, requires = "original", conflicts_with = "near")]
    known_cameras: bool,
    /// With --original: do not look for where films were taken
    ///
    /// Where the message alone does not prove it and no --cameras are given, the film is located as `locate` does, and
    /// the message is read beside the original, and the owner's chips, which takes minutes. These are the second and
    /// third of three readings either way.
    #[arg(long, conflicts_with = "near")]
    no_locate: bool,
    #[command(flatten)]
    near: NearArgs,
    /// Write the verdict as a page for people: one HTML file that needs no other and no network
    ///
    /// It shows frames of the films, beside the original's if that is given, the bits, the controls, the hashes, and
    /// how somebody else repeats it. It holds the message and the command as typed: who has the page knows both.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    report: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "verify",
    has_input: true,
    needs_device: true,
    arguments: |row, _| vec!["--".to_owned(), row.input.clone()],
    reserved: &["overwrite"],
    keep: |path, report| {
        let text = serde_json::to_vec_pretty(&report).expect("it came as JSON");
        AtomicFile::write(path, Existing::Replace, &text)?;
        // The message is in the file alone.
        let evidence = &report["evidence"];
        let chips = &report["owner_chips"];
        Ok(serde_json::json!({ "verdict": report["verdict"], "p_value": evidence["p_value"], "owner_chips": chips }))
    },
    trial: None,
};

pub(crate) fn run(args: &VerifyArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    // Whether it may be written is known before the films are read.
    let page = args.report.as_deref().map(|path| AtomicFile::create(path, args.overwrite.existing())).transpose()?;
    let device = device::open(common)?;
    let clip = device::load_clip(&device, &args.clip, common)?;
    let receipt = Receipt::read(&args.receipt)?;
    let key = receipt.body.promise.key_for(&args.passphrase.key(&args.key, &clip, common)?)?;
    let sought = args.message.as_ref().map(|text| Sought::parse(text, &key)).transpose()?;
    let other_key = |path: &PathBuf| {
        Ok(OtherKey { name: path.display().to_string(), key: args.passphrase.key(path, &clip, common)? })
    };
    let other_keys = args.other_key.iter().map(other_key).collect::<Result<_, EngineError>>()?;
    let pretrained = args.pretrained.as_deref().map(PretrainedExtractor::read).transpose()?;
    let original = args.original.as_deref().map(Model::open).transpose()?;
    let clean = match &original {
        Some(model) => render_frames(&device, model, &cameras(&args.views, model)?)?,
        None => Vec::new(),
    };
    let trained = args.known_cameras.then(|| receipt.config(&args.receipt)).transpose()?.map(|config| config.views);
    let inputs = VerifyInputs {
        suspects: suspects::open(&args.suspects, &args.views, original.as_ref(), trained.as_ref(), common)?,
        filmed: match &original {
            Some(original) => suspects::filmed_by(&args.suspects, &args.views, original, &read_some(&args.frames))?,
            None => Vec::new(),
        },
        locatable: match args.no_locate || args.known_cameras || args.views.cameras.is_some() {
            true => Vec::new(),
            false => suspects::films(&args.suspects)?,
        },
        near: locator::near(&args.near)?,
        guesses: args.framing.guesses(),
        unrelated: args.unrelated.clone(),
        clean,
        other_keys,
        dates: DateFiles {
            root: args.root.clone(),
            timestamp: args.timestamp.clone(),
            authorities: args.trust.ca.clone(),
        },
    };
    let cache = common.session.as_ref().map(|session| session.verify_cache()).unwrap_or_default();
    let request = VerifyRequest {
        device: &device,
        clip: &clip,
        key: &key,
        sought,
        receipt: &args.receipt,
        pretrained: pretrained.as_ref(),
        original: original.as_ref(),
        trusted_clip: args.trust_clip,
        claims: args.claims,
        cache: &cache,
    };
    let options = ReadOptions { framing: args.framing.framing(), ..read_some(&args.frames) };
    let report = request.verify_observed(&inputs, &options, &mut ObserverBar::new(common))?;
    if let Some(page) = page {
        let repeat = Repeat::now(&device);
        page.finish(Document { report: &report, clean: &inputs.clean, repeat }.html()?.as_bytes())?;
    }
    print(common, &report, human)?;
    Ok(Outcome::Judged(report.verdict))
}

fn parse_digest(text: &str) -> Result<Digest, String> {
    Digest::from_hex(text).ok_or_else(|| "64 hexadecimal digits are expected".to_owned())
}
