//! `guard4d inspect`

use guard4d_engine::EngineError;
use guard4d_engine::scene::Model;
use guard4d_engine::tensor_file::TensorFile;
use guard4d_engine::watermark::receipt::Receipt;
use serde_json::{Value, json};

use crate::args::{Common, InspectArgs};
use crate::report::{Outcome, print};

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
        "key_id": receipt.body.promise.key_id.to_string(),
        "bits": receipt.body.promise.num_bits,
        "extractor": receipt.body.promise.extractor_mode,
        "figures": receipt.body.figures,
        "seconds": receipt.body.seconds,
        "device": receipt.body.device.name,
    }))
}

/// Names and shapes; never the secret.
fn tensors(args: &InspectArgs) -> Result<Value, EngineError> {
    let file = TensorFile::read(&args.path)?;
    let public = file.meta.iter().filter(|(name, _)| *name != "secret");
    let tensors = file.tensors.iter().map(|(name, tensor)| (name.clone(), json!(tensor.shape)));
    Ok(json!({
        "kind": file.meta.get("format").map_or("safetensors", String::as_str),
        "meta": public.collect::<std::collections::BTreeMap<_, _>>(),
        "tensors": tensors.collect::<serde_json::Map<_, _>>(),
    }))
}

fn model(args: &InspectArgs) -> Result<Value, EngineError> {
    let model = Model::open(&args.path)?;
    let means = &model.gaussians.means;
    let bound = |pick: fn(f32, f32) -> f32, start: f32| -> [f32; 3] {
        std::array::from_fn(|axis| means.iter().map(|m| m[axis]).fold(start, pick))
    };
    let kind = if model.deformation.is_some() { "dynamic model (4DGaussians)" } else { "static model (INRIA PLY)" };
    Ok(json!({
        "kind": kind,
        "splats": model.gaussians.len(),
        "sh_degree": model.gaussians.sh_degree,
        "lowest": bound(f32::min, f32::INFINITY),
        "highest": bound(f32::max, f32::NEG_INFINITY),
        "background": model.background,
        "ply": model.ply().path(),
        "notes": model.warnings,
    }))
}

fn lines(value: &Value) -> String {
    let Value::Object(map) = value else { return value.to_string() };
    map.iter()
        .map(|(name, v)| format!("  {name}: {}", v.as_str().map_or_else(|| v.to_string(), str::to_owned)))
        .collect::<Vec<_>>()
        .join("\n")
}
