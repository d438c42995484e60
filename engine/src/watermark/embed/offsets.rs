//! The offsets in training, with what Adam knows of them.

use guard4d_kernels::loss::Term;
use guard4d_kernels::loss::offset_penalty::{self, Blocks};
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState, RowRates, Tail};
use guard4d_kernels::shape::OffsetBases;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::config::EmbedConfig;
use crate::base::numbers::narrow;
use crate::render::Offsets;
use crate::scene::Model;
use crate::scene::gaussians::{CHANNELS, SH_FLOATS};

/// Offsets of a model's SH coefficients: N rows as the bases lay them out.
pub(super) struct TrainedOffsets {
    device: Device,
    num_splats: usize,
    sh_degree: u32,
    bases: OffsetBases,
    data: Buffer<f32>,
    state: AdamState,
    /// dL/d offsets, of one step.
    gradient: Buffer<f32>,
    penalty_sums: SumScratch,
}

impl TrainedOffsets {
    /// Zero offsets on `model`.
    pub(super) fn new(device: &Device, model: &Model, bases: OffsetBases) -> Result<Self, KernelError> {
        let num_splats = model.gaussians.len();
        let len = num_splats * bases.floats();
        Ok(Self {
            device: device.clone(),
            num_splats,
            sh_degree: model.gaussians.sh_degree,
            bases,
            data: device.buffer("offsets", len)?,
            state: AdamState::new(device, "offsets", len)?,
            gradient: device.buffer("v_offsets", len)?,
            penalty_sums: SumScratch::new(device, len.div_ceil(4))?,
        })
    }

    /// Splats.
    pub(super) fn num_splats(&self) -> usize {
        self.num_splats
    }

    /// SH coefficients of a splat that have offsets.
    pub(super) fn coefficients(&self) -> usize {
        match self.bases {
            OffsetBases::Dc => 1,
            OffsetBases::All => (self.sh_degree as usize + 1).pow(2),
        }
    }

    /// Which coefficients have offsets.
    pub(super) fn bases(&self) -> OffsetBases {
        self.bases
    }

    /// For the renderer.
    pub(super) fn as_rendered(&self) -> Offsets<'_> {
        Offsets { data: &self.data, bases: self.bases }
    }

    /// For the renderer's way back, with the gradient that it adds to.
    pub(super) fn with_gradient(&mut self) -> (Offsets<'_>, &mut Buffer<f32>) {
        (Offsets { data: &self.data, bases: self.bases }, &mut self.gradient)
    }

    /// The gradient as it was recorded last.
    pub(super) fn gradient(&self) -> &Buffer<f32> {
        &self.gradient
    }

    /// The offsets with Adam's moments, for a checkpoint.
    pub(super) fn state(&mut self) -> (&mut Buffer<f32>, &mut AdamState) {
        (&mut self.data, &mut self.state)
    }

    /// The offsets as they are now.
    pub(super) fn read(&self) -> Result<Vec<f32>, KernelError> {
        self.data.read()
    }

    /// Puts others in their place; what Adam knows stays.
    pub(super) fn write(&mut self, values: &[f32]) -> Result<(), KernelError> {
        self.data.write(values)
    }

    /// Takes the mark out again, and with it what Adam knows of it.
    pub(super) fn forget(&mut self) -> Result<(), KernelError> {
        let zeros = vec![0.0; self.data.len()];
        for buffer in [&mut self.data, &mut self.state.exp_avg, &mut self.state.exp_avg_sq] {
            buffer.write(&zeros)?;
        }
        self.state.steps = 0;
        Ok(())
    }

    /// Gives offsets to more coefficients; those that are there keep their values and moments.
    pub(super) fn widen(&mut self, bases: OffsetBases) -> Result<(), KernelError> {
        let (from, to) = (self.bases.floats(), bases.floats());
        let wider = |name: &str, values: Vec<f32>| {
            let mut rows = vec![0.0; self.num_splats * to];
            for (row, before) in rows.chunks_exact_mut(to).zip(values.chunks_exact(from)) {
                row[..CHANNELS].copy_from_slice(&before[..CHANNELS]);
            }
            self.device.buffer_from(name, &rows)
        };
        let data = wider("offsets", self.data.read()?)?;
        let state = AdamState {
            exp_avg: wider("offsets.exp_avg", self.state.exp_avg.read()?)?,
            exp_avg_sq: wider("offsets.exp_avg_sq", self.state.exp_avg_sq.read()?)?,
            steps: self.state.steps,
            rates: None,
        };
        let len = data.len();
        self.gradient = self.device.buffer("v_offsets", len)?;
        self.penalty_sums = SumScratch::new(&self.device, len.div_ceil(4))?;
        (self.data, self.state, self.bases) = (data, state, bases);
        Ok(())
    }

    /// Factors on the rates of each splat's offsets, one for each splat.
    pub(super) fn rates(&self, factors: &[f32]) -> Result<RowRates, KernelError> {
        Ok(RowRates { row: self.bases.floats(), factors: self.device.buffer_from("visibility.rates", factors)? })
    }

    /// Takes these from the next step on; `None` is 1 everywhere.
    pub(super) fn set_rates(&mut self, rates: Option<RowRates>) {
        self.state.rates = rates;
    }

    /// Adds the offset penalty to the gradient.
    pub(super) fn add_penalty(&mut self, rec: &mut Recorder, term: Term<'_>) -> Result<(), KernelError> {
        let blocks = Blocks { bases: self.bases, degree: self.sh_degree, dc: 1.0, rest: 1.0 };
        offset_penalty::step(rec, &self.data, blocks, &mut self.gradient, term, &mut self.penalty_sums)
    }

    /// Adam with both parameter groups, the offsets being scaled besides.
    pub(super) fn step(
        &mut self,
        rec: &mut Recorder,
        config: &EmbedConfig,
        decay: f32,
        offset_scale: f32,
    ) -> Result<(), KernelError> {
        let lr = config.optimiser.lr_dc * decay;
        let tail = match config.fidelity.bases {
            OffsetBases::Dc => None,
            OffsetBases::All => Some(Tail {
                row: config.fidelity.bases.floats(),
                head: CHANNELS,
                lr: lr * config.optimiser.lr_rest_share,
            }),
        };
        let bound = config.fidelity.largest_offset(self.sh_degree).map_or(f32::INFINITY, narrow);
        let adam = AdamConfig { lr, keep: offset_scale, bound, tail, ..AdamConfig::default() };
        adam::step(rec, &mut self.data, &self.gradient, &mut self.state, &adam)
    }

    /// Coefficients plus offsets; those with an offset of zero keep their bits, also those of a negative zero.
    pub(super) fn added_to(&self, clean: &[f32], offsets: &[f32]) -> Vec<f32> {
        let mut marked = clean.to_vec();
        for (splat, row) in marked.chunks_exact_mut(SH_FLOATS).zip(offsets.chunks_exact(self.bases.floats())) {
            for (h, d) in splat.iter_mut().zip(&row[..CHANNELS * self.bases.count()]).filter(|(_, d)| **d != 0.0) {
                *h += d;
            }
        }
        marked
    }
}
