//! Stopping an embedding and going on later, to the same bytes.

use std::path::Path;

use guard4d_kernels::optim::adam::AdamState;
use guard4d_kernels::{Buffer, KernelError};

use super::Embedding;
use super::ladder::Standing;
use crate::error::EngineError;
use crate::output::{AtomicFile, Existing};
use crate::tensor_file::{Tensor, TensorFile};

/// `format` entry of a checkpoint.
const FORMAT: &str = "guard4d.checkpoint/4";
/// Number of the mixing that was taken; left out while mixings are tried, which begins anew.
const MIXING: &str = "mixing";
/// Tensor of the last control's logits.
const HELD_CONTROL: &str = "control_logits";
/// Entry of a [`Standing`], as JSON.
const STANDING: &str = "standing";

impl Embedding<'_> {
    /// What a checkpoint must agree with: settings, key, message, the unmarked coefficients and a given
    /// extractor.
    fn identity(&self) -> String {
        let settings = serde_json::to_string(&self.config).expect("numbers and words are valid JSON");
        let mut hasher = blake3::Hasher::new();
        hasher.update(settings.as_bytes());
        hasher.update(self.subject.clip.precision().name().as_bytes());
        hasher.update(self.subject.key.prf().key_id().to_string().as_bytes());
        hasher.update(self.subject.message.commitment(&self.subject.key.prf()).to_string().as_bytes());
        hasher.update(bytemuck::cast_slice(&self.subject.model.gaussians.sh_coeffs));
        if let Some(frozen) = &self.frozen {
            hasher.update(frozen.to_string().as_bytes());
        }
        hasher.finalize().to_string()
    }

    /// The last control's logits, where a step without a control of its own will ask for them.
    fn held_control(&mut self) -> Option<&mut Buffer<f32>> {
        self.critic.control_logits().filter(|_| self.config.control_every > 1)
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
        if self.audition.is_none() {
            file.meta.insert(MIXING.to_owned(), self.weights.mixing.number.to_string());
        }
        let held = vec![self.mean_mse.unwrap_or(f32::NAN), self.keep];
        file.tensors.insert("held".to_owned(), Tensor::f32(&[2], held));
        let standing = serde_json::to_string(&self.standing).expect("figures that are no numbers were refused");
        file.meta.insert(STANDING.to_owned(), standing);
        store(&mut file, "offsets", &self.stage.offsets, &self.stage.offsets_state)?;
        if let Some(logits) = self.held_control() {
            file.tensors.insert(HELD_CONTROL.to_owned(), Tensor::f32(&[logits.len()], logits.read()?));
        }
        if let Some(tmsd) = self.critic.features.tmsd() {
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
            return Err(file.bad("identity", "another embedding", "the same model, key, message and settings"));
        }
        if !file.meta.contains_key(MIXING) {
            return Ok(());
        }
        let whole = |field: &str, text: &str| text.parse::<usize>().map_err(|_| file.bad(field, text, "a number"));
        let step = whole("step", file.text("step")?)?;
        if let Some(audition) = self.audition.take() {
            let number = file.text(MIXING)?.parse().ok().filter(|number| *number < self.config.mixings);
            let expected = format!("a number below {}", self.config.mixings);
            let number = number.ok_or_else(|| file.bad(MIXING, file.text(MIXING).unwrap_or_default(), &expected))?;
            self.take_mixing(&audition, number)?;
        }
        let text = file.text(STANDING)?;
        let standing: Standing = serde_json::from_str(text)
            .map_err(|error| file.bad(STANDING, text, &format!("where an embedding stands: {error}")))?;
        let held = file.floats("held", &[2])?;
        let (mean_mse, keep) = ((!held[0].is_nan()).then_some(held[0]), held[1]);
        let is_elsewhere = standing.rung != self.standing.rung;
        self.standing = standing;
        if is_elsewhere {
            self.take_rung()?;
        }
        load(&file, "offsets", &mut self.stage.offsets, &mut self.stage.offsets_state, step)?;
        if let Some(logits) = self.held_control() {
            let read = file.floats(HELD_CONTROL, &[logits.len()])?;
            logits.write(read)?;
        }
        if let Some(tmsd) = self.critic.features.tmsd() {
            for (name, weight, state) in tmsd.states() {
                load(&file, &name, weight, state, step)?;
            }
        }
        (self.step, self.mean_mse, self.keep) = (step, mean_mse, keep);
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
