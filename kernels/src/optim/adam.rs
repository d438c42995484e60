//! Adam update.

use crate::error::KernelError;
use crate::registry::optim::{adam_step, adam_step_rated};
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Device, Grid, Recorder};

const KERNEL: &str = "optim/adam";

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
    /// Largest magnitude that a parameter has after the step: the step ends in the box of that size (projected gradient
    /// descent). Infinite for none.
    pub bound: f32,
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
        Self { lr: 1e-3, beta1: 0.9, beta2: 0.999, eps: 1e-8, keep: 1.0, bound: f32::INFINITY, tail: None }
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
    /// Factors on the learning rate; `None` for 1 everywhere.
    pub rates: Option<RowRates>,
}

/// A factor on the learning rates for each row of a parameter group.
#[derive(Debug)]
pub struct RowRates {
    /// Elements of a row; that of the [`Tail`], where there is one.
    pub row: usize,
    /// `[n / row]`; where it is 0 a parameter only decays, and so stays 0 if it is.
    pub factors: Buffer<f32>,
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
            rates: None,
        })
    }
}

/// One Adam step on `param`.
///
/// # Shapes
/// in `v_param` \[n\] · in/out `param` \[n\] (=) · `state` moments \[n\] (=), its rates \[n / row\]; with a tail or
/// rates n is a multiple of their row
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
    let Tail { row, head, lr: lr_tail } = groups(n, v_param, state, config)?;
    state.steps += 1;
    let exponent = i32::try_from(state.steps).unwrap_or(i32::MAX);
    let (bias1, bias2) = (1.0 - config.beta1.powi(exponent), 1.0 - config.beta2.powi(exponent));
    let AdamConfig { lr, beta1, beta2, eps, keep, bound, .. } = *config;
    let (row_size, head) = (dim(row), dim(head));
    for rows in rec.pieces(n / row, size_of::<f32>() * row) {
        let part = |buffer: &Buffer<f32>| buffer.part(rows.start * row..rows.end * row);
        let [param_before, exp_avg_before, exp_avg_sq_before] = [&*param, &state.exp_avg, &state.exp_avg_sq].map(part);
        let [mut param, mut exp_avg, mut exp_avg_sq] =
            [&param_before, &exp_avg_before, &exp_avg_sq_before].map(Buffer::alias);
        let threads = param.len().div_ceil(4);
        /// Binds and runs one variant; only the module that the types come from and its own buffer differ.
        macro_rules! update {
            ($module:ident $(, $rates:ident)?) => {{
                let bind = $module::Bind {
                    param_before: &param_before,
                    exp_avg_before: &exp_avg_before,
                    exp_avg_sq_before: &exp_avg_sq_before,
                    v_param: &part(v_param),
                    param: &mut param,
                    exp_avg: &mut exp_avg,
                    exp_avg_sq: &mut exp_avg_sq,
                    $($rates,)?
                };
                let (texels, first_row) = (dim(threads), dim(rows.start));
                let params =
                    $module::Params { texels, first_row, lr, lr_tail, beta1, beta2, eps, bias1, bias2, keep, bound };
                rec.dispatch_spec(bind, params, $module::Spec { row: row_size, head }, Grid::threads(threads))?;
            }};
        }
        match &state.rates {
            None => update!(adam_step),
            Some(RowRates { factors: rates, .. }) => update!(adam_step_rated, rates),
        }
    }
    Ok(())
}

/// Checks the lengths; both parameter groups, which are one where there is no tail.
fn groups(n: usize, v_param: &Buffer<f32>, state: &AdamState, config: &AdamConfig) -> Result<Tail, KernelError> {
    for (buffer, len) in
        [("v_param", v_param.len()), ("exp_avg", state.exp_avg.len()), ("exp_avg_sq", state.exp_avg_sq.len())]
    {
        if len != n {
            return Err(KernelError::Shape {
                kernel: KERNEL,
                buffer,
                got: format!("[{len}]"),
                expected: format!("[{n}] like param"),
            });
        }
    }
    let rated = state.rates.as_ref().map(|rates| rates.row);
    let row = config.tail.map(|tail| tail.row).or(rated).unwrap_or(1);
    if row == 0 || !n.is_multiple_of(row) || rated.is_some_and(|rated| rated != row) {
        let rated = rated.map_or(String::new(), |rated| format!(", and rates for rows of {rated}"));
        return Err(KernelError::Shape {
            kernel: KERNEL,
            buffer: "param",
            got: format!("[{n}]{rated}"),
            expected: format!("rows of {row}"),
        });
    }
    if let Some(RowRates { factors, .. }) = &state.rates {
        expect_len(KERNEL, "rates", factors, n / row)?;
    }
    Ok(config.tail.unwrap_or(Tail { row, head: row, lr: config.lr }))
}
