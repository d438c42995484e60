//! Stopping an embedding and going on later, to the same bytes.

use std::path::Path;

use guard4d_kernels::optim::adam::AdamState;
use guard4d_kernels::{Buffer, KernelError};

use super::embedding::Embedding;
use super::fidelity_hold::FidelityHold;
use super::progress::Progress;
use crate::base::output::{AtomicFile, Existing};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::watermark::key::owner_key::digest_of;

/// `format` entry of a checkpoint.
const FORMAT: &str = "guard4d.checkpoint/6";
/// Number of the rotation that was taken; left out while rotations are tried, which begins anew.
const KEY_ROTATION: &str = "key_rotation";
/// Tensor of the last control's logits.
const HELD_CONTROL: &str = "control_logits";
/// Entry of a [`Progress`], as JSON.
const PROGRESS: &str = "progress";

impl Embedding<'_> {
    /// What a checkpoint must agree with: settings, key, message, the unmarked scene with its motion and its
    /// background, the CLIP checkpoint and a given extractor.
    fn identity(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.config.identity().as_bytes());
        hasher.update(digest_of(self.subject.clip).to_string().as_bytes());
        hasher.update(self.subject.clip.precision().name().as_bytes());
        hasher.update(self.subject.key.prf().key_id().to_string().as_bytes());
        hasher.update(self.subject.key.decoder_digest().to_string().as_bytes());
        hasher.update(self.subject.message.commitment(&self.subject.key.prf()).to_string().as_bytes());
        hasher.update(self.subject.model.content().to_string().as_bytes());
        if let Some(frozen) = &self.frozen {
            hasher.update(frozen.to_string().as_bytes());
        }
        hasher.finalize().to_string()
    }

    /// The last control's logits, where a step without a control of its own will ask for them.
    fn held_control(&mut self) -> Option<&mut Buffer<f32>> {
        self.loss.control_logits().filter(|_| self.config.control_every() > 1)
    }

    /// Writes everything that the next step depends on.
    ///
    /// # Errors
    /// [`EngineError::Io`] naming the file; when reading from the device fails.
    pub fn save(&mut self, path: &Path) -> Result<(), EngineError> {
        let mut file = TensorFile { path: path.to_owned(), ..TensorFile::default() };
        file.meta.insert("format".to_owned(), FORMAT.to_owned());
        file.meta.insert("identity".to_owned(), self.identity());
        file.meta.insert("step".to_owned(), self.step.to_string());
        if self.search.is_none() {
            file.meta.insert(KEY_ROTATION.to_owned(), self.weights.key_rotation.number.to_string());
        }
        let held = vec![self.hold.mean_mse.unwrap_or(f32::NAN), self.hold.offset_scale];
        file.tensors.insert("held".to_owned(), Tensor::f32(&[2], held));
        let progress = serde_json::to_string(&self.progress).expect("figures that are no numbers were refused");
        file.meta.insert(PROGRESS.to_owned(), progress);
        let (offsets, state) = self.buffers.offsets.state();
        store(&mut file, "offsets", offsets, state)?;
        if let Some(logits) = self.held_control() {
            file.tensors.insert(HELD_CONTROL.to_owned(), Tensor::f32(&[logits.len()], logits.read()?));
        }
        if let Some(tmsd) = self.loss.tmsd() {
            for (name, weight, state) in tmsd.states() {
                store(&mut file, &name, weight, state)?;
            }
        }
        AtomicFile::write(path, Existing::Replace, &file.to_bytes()?)
    }

    /// Takes up the state of a checkpoint of the same embedding.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when it belongs to another embedding or is damaged.
    pub fn restore(&mut self, path: &Path) -> Result<(), EngineError> {
        let file = TensorFile::read(path)?;
        file.expect_text("format", FORMAT)?;
        if file.text("identity")? != self.identity() {
            return Err(file.bad(
                "identity",
                "another embedding",
                "the same model, motion, key, message, CLIP and settings",
            ));
        }
        if !file.meta.contains_key(KEY_ROTATION) {
            return Ok(());
        }
        let whole = |field: &str, text: &str| text.parse::<usize>().map_err(|_| file.bad(field, text, "a number"));
        let step = whole("step", file.text("step")?)?;
        if let Some(search) = self.search.take() {
            let rotations = self.config.extractor.rotations();
            let number = file.text(KEY_ROTATION)?.parse().ok().filter(|number| *number < rotations);
            let expected = format!("a number below {rotations}");
            let number =
                number.ok_or_else(|| file.bad(KEY_ROTATION, file.text(KEY_ROTATION).unwrap_or_default(), &expected))?;
            self.take_rotation(&search, number)?;
        }
        let text = file.text(PROGRESS)?;
        let progress: Progress = serde_json::from_str(text)
            .map_err(|error| file.bad(PROGRESS, text, &format!("how far an embedding is: {error}")))?;
        let held = file.floats("held", &[2])?;
        let hold = FidelityHold { mean_mse: (!held[0].is_nan()).then_some(held[0]), offset_scale: held[1] };
        let is_elsewhere = progress.phase != self.progress.phase;
        self.progress = progress;
        if is_elsewhere {
            self.take_phase()?;
        }
        let (offsets, state) = self.buffers.offsets.state();
        load(&file, "offsets", offsets, state, step)?;
        if let Some(logits) = self.held_control() {
            let read = file.floats(HELD_CONTROL, &[logits.len()])?;
            logits.write(read)?;
        }
        if let Some(tmsd) = self.loss.tmsd() {
            for (name, weight, state) in tmsd.states() {
                load(&file, &name, weight, state, step)?;
            }
        }
        (self.step, self.hold) = (step, hold);
        Ok(())
    }
}

fn store(file: &mut TensorFile, name: &str, param: &Buffer<f32>, state: &AdamState) -> Result<(), KernelError> {
    for (part, buffer) in [("param", param), ("exp_avg", &state.exp_avg), ("exp_avg_sq", &state.exp_avg_sq)] {
        file.tensors.insert(format!("{name}.{part}"), Tensor::f32(&[buffer.len()], buffer.read()?));
    }
    file.meta.insert(format!("{name}.steps"), state.steps.to_string());
    Ok(())
}

fn load(
    file: &TensorFile,
    name: &str,
    param: &mut Buffer<f32>,
    state: &mut AdamState,
    step: usize,
) -> Result<(), EngineError> {
    for (part, buffer) in [("param", param), ("exp_avg", &mut state.exp_avg), ("exp_avg_sq", &mut state.exp_avg_sq)] {
        let values = file.floats(&format!("{name}.{part}"), &[buffer.len()])?;
        buffer.write(values)?;
    }
    let field = format!("{name}.steps");
    let text = file.text(&field)?;
    let steps: Option<u32> = text.parse().ok().filter(|s| *s as usize <= step);
    state.steps = steps.ok_or_else(|| EngineError::BadData {
        path: file.path.clone(),
        field,
        got: text.to_owned(),
        expected: format!("a number up to {step}"),
    })?;
    Ok(())
}
