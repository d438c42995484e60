//! Adam update.

use crate::registry::optim::adam_step;
use crate::shape::dim;
use crate::{Buffer, Device, Grid, KernelError, Recorder};

/// Hyperparameters and rate of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamConfig {
    /// Learning rate of this step.
    pub lr: f32,
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the root of the second moment.
    pub eps: f32,
    /// Factor on the parameter before the step: 1 − decay.
    pub keep: f32,
    /// Second parameter group inside the buffer.
    pub tail: Option<Tail>,
}

/// The elements of each row from the first few on, with a learning rate of their own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tail {
    /// Elements of a row.
    pub row: usize,
    /// Elements of a row that the tail leaves to the main rate.
    pub head: usize,
    /// Learning rate of the tail.
    pub lr: f32,
}

impl Default for AdamConfig {
    fn default() -> Self {
        Self { lr: 1e-3, beta1: 0.9, beta2: 0.999, eps: 1e-8, keep: 1.0, tail: None }
    }
}

/// Moments of one parameter group.
#[derive(Debug)]
pub struct AdamState {
    /// First moment `[n]`.
    pub exp_avg: Buffer<f32>,
    /// Second moment `[n]`.
    pub exp_avg_sq: Buffer<f32>,
    /// Steps taken.
    pub steps: u32,
}

impl AdamState {
    /// Zero moments for `n` parameters.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, name: &str, n: usize) -> Result<Self, KernelError> {
        Ok(Self {
            exp_avg: device.buffer(&format!("{name}.exp_avg"), n)?,
            exp_avg_sq: device.buffer(&format!("{name}.exp_avg_sq"), n)?,
            steps: 0,
        })
    }
}

/// One Adam step on `param`.
///
/// # Shapes
/// in `v_param` [n] · in/out `param` [n] (=) · `state` moments [n] (=); with a tail n is a multiple of its row
/// # Equation: Adam, Kingma & Ba 2015, Algorithm 1; decoupled decay of Loshchilov & Hutter 2019, Algorithm 2
/// # Errors: [`KernelError::Shape`] before anything is recorded
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// See above.
pub fn step(
    rec: &mut Recorder,
    param: &mut Buffer<f32>,
    v_param: &Buffer<f32>,
    state: &mut AdamState,
    config: &AdamConfig,
) -> Result<(), KernelError> {
    let n = param.len();
    for (buffer, len) in
        [("v_param", v_param.len()), ("exp_avg", state.exp_avg.len()), ("exp_avg_sq", state.exp_avg_sq.len())]
    {
        if len != n {
            return Err(KernelError::Shape {
                kernel: "optim/adam",
                buffer,
                got: format!("[{len}]"),
                expected: format!("[{n}] like param"),
            });
        }
    }
    let Tail { row, head, lr: lr_tail } = config.tail.unwrap_or(Tail { row: 1, head: 1, lr: config.lr });
    if row == 0 || !n.is_multiple_of(row) {
        return Err(KernelError::Shape {
            kernel: "optim/adam",
            buffer: "param",
            got: format!("[{n}]"),
            expected: format!("rows of {row}"),
        });
    }
    state.steps += 1;
    let exponent = i32::try_from(state.steps).unwrap_or(i32::MAX);
    let mut params = adam_step::Params {
        texels: 0,
        lr: config.lr,
        lr_tail,
        beta1: config.beta1,
        beta2: config.beta2,
        eps: config.eps,
        bias1: 1.0 - config.beta1.powi(exponent),
        bias2: 1.0 - config.beta2.powi(exponent),
        keep: config.keep,
    };
    for rows in rec.pieces(n / row, size_of::<f32>() * row) {
        let part = |buffer: &Buffer<f32>| buffer.part(rows.start * row..rows.end * row);
        let before = [&*param, &state.exp_avg, &state.exp_avg_sq].map(part);
        let [mut param, mut exp_avg, mut exp_avg_sq] = before.each_ref().map(Buffer::alias);
        let texels = param.len().div_ceil(4);
        params.texels = dim(texels);
        let bind = adam_step::Bind {
            param_before: &before[0],
            exp_avg_before: &before[1],
            exp_avg_sq_before: &before[2],
            v_param: &part(v_param),
            param: &mut param,
            exp_avg: &mut exp_avg,
            exp_avg_sq: &mut exp_avg_sq,
        };
        rec.dispatch_spec(bind, params, adam_step::Spec { row: dim(row), head: dim(head) }, Grid::threads(texels))?;
    }
    Ok(())
}
