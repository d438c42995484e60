//! The commands on a CLIP as large as OpenAI's ViT-B/32, with random weights: `keygen`, `embed` and `verify`.
//!
//! Random weights see nothing, so what is read says nothing of how well a mark is read. That every command gets through
//! towers of this size, in how much time and memory, does not depend on the weights. `./x full-size` runs it.

#![allow(clippy::cast_possible_truncation, reason = "weights are single precision")]

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use clap::Parser;
use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipConfig;
use guard4d_engine::scene::demo::DemoScene;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const SEED: u64 = 1;
/// How often a command's memory is looked at.
const LOOK: Duration = Duration::from_millis(50);
/// Sizes of the runs: enough for every kernel of a step, control and calibration.
const SMALL: [&str; 8] = ["--steps", "2", "--train-clips", "2", "--responses", "8", "--size", "96x96"];
const VIEWS: [&str; 4] = ["--orbit", "1", "--frames", "8"];

/// Runs keygen, embed and verify with random weights of ViT-B/32's shapes
#[derive(Debug, Parser)]
#[command(name = "./x full-size")]
struct Args {
    /// Folder for checkpoint, key, marked models and report.md
    #[arg(long, default_value = "target/full-size")]
    out: PathBuf,
    /// Message bits
    #[arg(long, default_value_t = 8)]
    bits: u32,
    /// Given by cargo
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// What a command took.
struct Took {
    name: String,
    code: Option<i32>,
    seconds: f64,
    peak_bytes: u64,
}

/// Runs everything; whether all commands ended as they should.
fn run(args: &Args) -> Result<bool, EngineError> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| EngineError::Io { path, source }
    };
    let out = &args.out;
    std::fs::create_dir_all(out).map_err(io(out))?;
    let clip = out.join("random-vit-b-32");
    if !clip.join("model.safetensors").exists() {
        write_checkpoint(&clip)?;
    }
    let scene = DemoScene::unpack()?;
    let key = out.join("owner.key");
    let (clip, key, model) = (text(&clip), text(&key), text(scene.path()));
    let with_clip = ["--clip", &clip, "--key", &key];
    let bits = args.bits.to_string();
    let mut took = vec![measure("keygen", &["keygen", "--clip", &clip, "--bits", &bits, "--out", &key, "-w"], &[0])?];
    for mode in ["blind", "joint"] {
        let folder = text(&out.join(mode));
        let embed = ["embed", &model, "--extractor", mode, "--out", &folder, "-w"];
        // So few steps miss the quality gate.
        took.push(measure(&format!("embed, {mode}"), &[&embed[..], &with_clip, &SMALL, &VIEWS].concat(), &[0, 1])?);
        let (preview, receipt) = (format!("{folder}/preview"), format!("{folder}/private/receipt.json"));
        let verify = ["verify", &preview, "--receipt", &receipt, "--original", &model, "--size", "96x96"];
        took.push(measure(&format!("verify, {mode}"), &[&verify[..], &with_clip, &VIEWS].concat(), &[0, 1, 4])?);
    }
    let table = report(&took);
    print!("{table}");
    let path = out.join("report.md");
    std::fs::write(&path, table).map_err(io(&path))?;
    Ok(took.iter().all(|t| t.code.is_some()))
}

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// Runs the program, and looks at its memory while it runs. A code that is not `expected` is none.
fn measure(name: &str, args: &[&str], expected: &[i32]) -> Result<Took, EngineError> {
    let program = env!("CARGO_BIN_EXE_guard4d");
    let failed = |reason: String| EngineError::Program { program: program.to_owned(), reason };
    eprintln!("guard4d {}", args.join(" "));
    let started = Instant::now();
    let mut child =
        Command::new(program).args(args).stdout(Stdio::null()).spawn().map_err(|error| failed(error.to_string()))?;
    let mut peak_bytes = 0;
    let status = loop {
        peak_bytes = peak_bytes.max(peak_of(child.id()));
        match child.try_wait().map_err(|error| failed(error.to_string()))? {
            Some(status) => break status,
            None => std::thread::sleep(LOOK),
        }
    };
    let code = status.code().filter(|code| expected.contains(code));
    if code.is_none() {
        eprintln!("{name} ended with {status}");
    }
    Ok(Took { name: name.to_owned(), code, seconds: started.elapsed().as_secs_f64(), peak_bytes })
}

/// Most memory that a process has had so far, in bytes; 0 where the system does not tell. A processor's device memory
/// is part of it.
fn peak_of(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok()).unwrap_or(0) * 1024
}

fn report(took: &[Took]) -> String {
    let mut table = "| command | exit code | seconds | peak memory, MB |\n| --- | ---: | ---: | ---: |\n".to_owned();
    for Took { name, code, seconds, peak_bytes } in took {
        let code = code.map_or_else(|| "failed".to_owned(), |code| code.to_string());
        table += &format!("| {name} | {code} | {seconds:.1} | {:.0} |\n", *peak_bytes as f64 * 1e-6);
    }
    table
}

/// A checkpoint with the sizes that `config.json` has by default, which are ViT-B/32's, as Hugging Face lays it out.
///
/// Matrices keep the length of what they multiply, and tokens are as long as the residual stream, so that the end token
/// hears the others: with the small tokens of a fresh model the features of all messages are one point, which keygen
/// refuses.
fn write_checkpoint(folder: &Path) -> Result<(), EngineError> {
    std::fs::create_dir_all(folder).map_err(|source| EngineError::Io { path: folder.to_owned(), source })?;
    let sizes = ClipConfig::from_json(folder, b"{\"projection_dim\": 512}")?;
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut tensor = |name: &str, shape: &[usize]| {
        let inputs = shape.iter().skip(1).product::<usize>();
        let (centre, width) = match shape.len() {
            0 | 1 if name.ends_with("weight") => (1.0, 0.1),
            0 | 1 => (0.0, 0.1),
            _ if name.contains("embedding.weight") && !name.contains("patch") => (0.0, 1.0),
            _ => (0.0, (3.0 / inputs as f32).sqrt()),
        };
        let mut value = || centre + width * ((rng.next_u32() >> 8) as f32 / (1 << 23) as f32 - 1.0);
        Tensor::f32(shape, (0..shape.iter().product()).map(|_| value()).collect())
    };
    let tensors = sizes.tensors();
    let tensors = tensors.iter().map(|(name, shape)| (name.clone(), tensor(name, shape))).collect();
    let path = folder.join("model.safetensors");
    let bytes = TensorFile { path: path.clone(), tensors, ..TensorFile::default() }.to_bytes()?;
    std::fs::write(&path, bytes).map_err(|source| EngineError::Io { path, source })?;
    let config = serde_json::to_vec_pretty(&sizes).expect("sizes and words are valid JSON");
    let path = folder.join("config.json");
    std::fs::write(&path, config).map_err(|source| EngineError::Io { path, source })
}
