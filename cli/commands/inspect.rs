//! `guard4d inspect`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::id_code::{IdBits, IdCode};
use guard4d_engine::evidence::message::MAX_MESSAGE_BITS;
use guard4d_engine::evidence::statistics::{SHOWN_RATES, shown_thresholds};
use guard4d_engine::release::receipt::Receipt;
use guard4d_engine::scene::gaussians::SH_FLOATS;
use guard4d_engine::scene::{Model, Motion};
use guard4d_engine::watermark::key::key_file::SECRETS;
use serde_json::{Value, json};

use crate::flags::common::Common;
use crate::ui::outcome::Outcome;
use crate::ui::report::print;

/// What is looked at.
#[derive(Args, Debug)]
pub(crate) struct InspectArgs {
    /// Model folder or file, key (with how many bits have to match) or receipt
    path: PathBuf,
}

pub(crate) fn run(args: &InspectArgs, common: &Common) -> Result<Outcome, EngineError> {
    let extension = args.path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let facts = match extension {
        "json" => receipt(args)?,
        "key" | "safetensors" => tensors(args)?,
        _ => model(args)?,
    };
    print(common, &facts, lines)?;
    Ok(Outcome::Done)
}

fn receipt(args: &InspectArgs) -> Result<Value, EngineError> {
    let receipt = Receipt::read(&args.path)?;
    receipt.verify_commitment(&args.path)?;
    Ok(json!({
        "kind": "receipt, commitment intact",
        "schema": receipt.schema,
        "commitment": receipt.commitment,
        "anchor": receipt.body.promise.anchor,
        "key_id": receipt.body.promise.key_id.to_string(),
        "bits": receipt.body.promise.num_bits,
        "payload": receipt.body.promise.payload,
        "extractor": receipt.body.promise.extractor_mode,
        "figures": receipt.body.figures,
        "seconds": receipt.body.seconds,
        "device": receipt.body.device.name,
    }))
}

/// Names and shapes; never a secret.
fn tensors(args: &InspectArgs) -> Result<Value, EngineError> {
    let file = TensorFile::read(&args.path)?;
    let public = file.meta.iter().filter(|(name, _)| !SECRETS.contains(&name.as_str()));
    let tensors = file.tensors.iter().map(|(name, tensor)| (name.clone(), json!(tensor.shape)));
    let mut facts = json!({
        "kind": file.meta.get("format").map_or("safetensors", String::as_str),
        "meta": public.collect::<std::collections::BTreeMap<_, _>>(),
        "tensors": tensors.collect::<serde_json::Map<_, _>>(),
    });
    let bits = file.meta.get("bits").and_then(|text| text.parse().ok());
    if let Some(bits) = bits.filter(|bits| (1..=MAX_MESSAGE_BITS).contains(bits)) {
        facts["matches_needed"] = matches_needed(bits);
    }
    Ok(facts)
}

/// How many bits of a key's length have to match at each false-positive rate: for a message that was claimed, and for
/// the best of all ids. Nothing where even all bits prove too little.
fn matches_needed(bits: u32) -> Value {
    let row = |searched: u32| -> Value {
        let needed = SHOWN_RATES.iter().zip(shown_thresholds(bits, searched));
        needed.map(|(rate, matches)| (format!("{rate:.0e}"), json!(matches))).collect::<serde_json::Map<_, _>>().into()
    };
    let mut rows = serde_json::Map::from_iter([("claimed".to_owned(), row(1))]);
    let codes = IdBits::ALL.into_iter().filter(|id_bits| IdCode::new(*id_bits, bits).is_ok());
    rows.extend(codes.map(|id_bits| (id_bits.to_string(), row(id_bits.num_ids()))));
    rows.into()
}

fn model(args: &InspectArgs) -> Result<Value, EngineError> {
    let model = Model::open(&args.path)?;
    let means = &model.gaussians.means;
    let source = &model.sources()[0];
    let bound = |pick: fn(f32, f32) -> f32, start: f32| -> [f32; 3] {
        std::array::from_fn(|axis| means.iter().map(|m| m[axis]).fold(start, pick))
    };
    let kind = match &model.motion {
        Motion::Still => "static model",
        Motion::HexPlane(_) => "dynamic model (4DGaussians)",
        Motion::Warp(_) => "dynamic model (Deformable-3DGS)",
        Motion::Paths(_) => "dynamic model (splats on paths)",
        Motion::Sequence(_) => "dynamic model (a file for each moment)",
    };
    Ok(json!({
        "kind": kind,
        "splats": model.gaussians.len(),
        "sh_degree": model.gaussians.sh_degree,
        "lowest": bound(f32::min, f32::INFINITY),
        "highest": bound(f32::max, f32::NEG_INFINITY),
        "background": model.background,
        "format": source.format().to_string(),
        "moments": model.sources().len(),
        "colours": if model.is_rgb() { "RGB" } else { "SH" },
        "file_bytes": model.sources().iter().map(|source| source.bytes().len()).sum::<usize>(),
        "device_bytes": model.gaussians.len() * DEVICE_BYTES,
        "comments": source.comments(),
        "can": abilities(&model),
        "notes": model.warnings,
    }))
}

/// Bytes that a splat takes on the device: coefficients, then means, scales and rotations of four floats each.
const DEVICE_BYTES: usize = size_of::<f32>() * (SH_FLOATS + 3 * 4);

/// What there is to do with a model.
fn abilities(model: &Model) -> Vec<String> {
    let source = &model.sources()[0];
    let mut can = vec!["render".to_owned(), "convert".to_owned()];
    can.push(match (model.check_writable(), source.is_imported()) {
        (Err(error), _) => format!("not embed: {error}"),
        (Ok(()), true) => "embed, as a PLY".to_owned(),
        (Ok(()), false) => "embed, in place".to_owned(),
    });
    can
}

fn lines(value: &Value) -> String {
    let Value::Object(map) = value else { return value.to_string() };
    map.iter()
        .map(|(name, v)| format!("  {name}: {}", v.as_str().map_or_else(|| v.to_string(), str::to_owned)))
        .collect::<Vec<_>>()
        .join("\n")
}
