//! What an embedding leaves behind: the marked model to hand out, and the private files to keep.
//!
//! `marked/` is the model; `private/` holds extractor, undo file and receipt; `preview/` has a clip of frames.

use std::path::Path;

use serde_json::to_value;

use super::classes::ClassFilms;
use super::evaluate::{Evaluation, HeldOut};
use super::gate::Gate;
use super::receipt::{
    Anchor, BitAccuracies, DeviceRecord, Figures, FileRecord, Promise, Receipt, ReceiptBody, Repeatability, Tool,
};
use super::{owner_chips, undo};
use crate::base::digest::Digest;
use crate::base::output::{Existing, create_private_dir};
use crate::base::signature::SigningKey;
use crate::error::EngineError;
use crate::evidence::id_code::IdBits;
use crate::evidence::thresholds::Thresholds;
use crate::media::png::write_png_folder;
use crate::networks::lpips::Lpips;
use crate::scene::CameraSet;
use crate::watermark::embed::{EmbedConfig, Embedded, Subject};
use crate::watermark::extractor::reader;
use crate::watermark::key::owner_key::Key;

/// Folder of the marked model.
pub const MARKED: &str = "marked";
/// Folder of the private files.
pub const PRIVATE: &str = "private";
/// Extractor in [`PRIVATE`].
pub const EXTRACTOR: &str = "extractor.safetensors";
/// Receipt in [`PRIVATE`].
pub const RECEIPT: &str = "receipt.json";
/// Undo file in [`PRIVATE`].
pub const UNDO: &str = "undo.safetensors";

/// A finished embedding on its way to disk.
#[derive(Debug)]
pub struct Delivery<'a> {
    /// What was embedded where.
    pub subject: Subject<'a>,
    /// Settings.
    pub config: &'a EmbedConfig,
    /// Result.
    pub embedded: &'a Embedded,
    /// Path of the unmarked model.
    pub input: &'a Path,
    /// Kind of id that the message carries, if it does.
    pub payload: Option<IdBits>,
    /// Films of each class of cameras that the mark is measured in.
    pub class_films: u32,
}

/// Writes everything into the existing folder `out`, the receipt last, and evaluates the mark on `cameras`. Returns the
/// clips that were evaluated, too.
///
/// # Errors
/// [`EngineError::Usage`] for another key than that of the asset; [`EngineError::Io`] naming the file; when the device
/// fails.
pub fn write(out: &Path, delivery: &Delivery<'_>, cameras: &CameraSet) -> Result<(Evaluation, HeldOut), EngineError> {
    let Delivery { subject, config, embedded, input, .. } = delivery;
    let device = subject.device;
    let signer = signer_of(subject.key, subject.model.digest())?;
    // What is measured is what is handed out, also where its format keeps colours coarsely.
    let with_chips = owner_chips::add(device, subject.model, subject.key, config, &embedded.sh_coeffs)?;
    let stored = subject.model.as_stored(&with_chips.sh_coeffs)?;
    let held_out = HeldOut::render(device, subject.model, &stored, cameras)?;
    let mut evaluation = held_out.evaluate(device, subject.clip, subject.key, &embedded.extractor, subject.message)?;
    if let Some(id_bits) = delivery.payload {
        evaluation.count_ids(id_bits, &subject.key.prf(), subject.message)?;
    }
    evaluation.classes = class_films(delivery)?.measure(*subject, &stored, &embedded.extractor)?;
    if let Some(term) = &config.objective.lpips {
        evaluation.lpips = Some(held_out.lpips(&Lpips::new(device, term.network.get()?, term.input)?)?);
    }
    let written = subject.model.write_marked(&out.join(MARKED), &stored)?;
    let private = out.join(PRIVATE);
    create_private_dir(&private)?;
    embedded.extractor.write(&private.join(EXTRACTOR), subject.key, Existing::Refuse)?;
    undo::write(&private.join(UNDO), subject.model, &stored)?;
    if let Some(clip) = held_out.marked.first() {
        write_png_folder(&out.join("preview"), clip)?;
    }
    let names: Vec<String> = written.marked.iter().map(|path| path.to_string_lossy().replace('\\', "/")).collect();
    let originals = names.iter().zip(subject.model.sources());
    let originals =
        originals.map(|(path, source)| FileRecord { path: path.clone(), blake3: Digest::of(source.bytes()) });
    let outputs = names.iter().map(|path| FileRecord::of(&out.join(MARKED), path)).collect::<Result<_, _>>()?;
    let info = device.info();
    let body = ReceiptBody {
        tool: Tool::current(),
        promise: Promise { owner_chips: with_chips.chips, ..promise(delivery)? },
        inputs: originals.collect(),
        outputs,
        settings: serde_json::json!({
            "input": input.file_name().map(|n| n.to_string_lossy()),
            "config": config.to_json(),
            "offset_on": if subject.model.is_rgb() { "RGB" } else { "SH" },
            "precision": subject.clip.precision().name(),
            "steps_taken": embedded.steps,
            "phases": to_value(&embedded.phases).unwrap_or_default(),
        }),
        figures: figures(&evaluation),
        seconds: embedded.seconds.clone(),
        peak_memory_bytes: Some(device.memory_use().peak_reserved_bytes),
        device: DeviceRecord {
            name: info.name.clone(),
            driver: info.driver.clone(),
            kernels: Some(device.family().to_string()),
            api_version: "1.2".to_owned(),
            repeatability: Repeatability::SameBytes,
        },
    };
    Receipt::seal(body, &signer)?.write(&private.join(RECEIPT))?;
    Ok((evaluation, held_out))
}

/// What signs the receipt of an asset.
///
/// # Errors
/// [`EngineError::Usage`] for another key than the owner's own of this asset.
pub fn signer_of(key: &Key, asset: Digest) -> Result<SigningKey, EngineError> {
    let refused = |got: String| EngineError::Usage {
        what: "key of a delivery".to_owned(),
        got,
        expected: format!("the owner's key of the asset {asset}"),
    };
    if key.asset() != Some(asset) {
        return Err(refused(key.asset().map_or_else(|| "a key of all assets".to_owned(), |other| other.to_string())));
    }
    key.signing_key().ok_or_else(|| refused("a disclosed key, which signs nothing".to_owned()))
}

fn class_films(delivery: &Delivery<'_>) -> Result<ClassFilms, EngineError> {
    let views = &delivery.config.views;
    let Subject { key, model, .. } = delivery.subject;
    let fpr = Gate::for_bits(key.bits()).fpr;
    Ok(ClassFilms { look_at: views.look_at(model), lens: views.lens()?, films: delivery.class_films, fpr })
}

fn promise(delivery: &Delivery<'_>) -> Result<Promise, EngineError> {
    let Subject { key, message, model, .. } = delivery.subject;
    let prf = key.prf();
    let extractor = &delivery.embedded.extractor;
    Ok(Promise {
        key_id: prf.key_id(),
        num_bits: message.num_bits(),
        message_mac: message.commitment(&prf),
        payload: delivery.payload,
        token_table: key.table.digest(),
        decoder: key.decoder_digest(),
        extractor_mode: extractor.mode,
        extractor: Some(extractor.digest(key)?),
        clip: key.clip,
        preprocess: extractor.preprocess(),
        thresholds: Thresholds::for_bits(key.bits()),
        owner_chips: None,
        anchor: Some(Anchor {
            asset: model.digest(),
            scene: model.content(),
            reader: reader::digest(key, extractor)?,
            signer: key.public_key(),
        }),
    })
}

fn figures(evaluation: &Evaluation) -> Figures {
    Figures {
        psnr: evaluation.psnr,
        foreground_psnr: Some(evaluation.foreground_psnr),
        ssim: evaluation.ssim,
        lpips: evaluation.lpips,
        bit_accuracy: BitAccuracies {
            frame: evaluation.marked_frames,
            clip: evaluation.marked,
            clean: Some(evaluation.clean),
            noisy: Some(evaluation.noisy),
        },
        classes: evaluation.classes.clone(),
    }
}
