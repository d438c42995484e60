//! The splats of a scene at any moment, whatever moves them; the latest moments are kept.

use std::sync::Arc;

use guard4d_kernels::{Buffer, Device};

use super::latest::Latest;
use super::network::{HiddenRows, Network};
use super::paths::PathField;
use super::sequence::Sequence;
use super::state::SplatState;
use super::warp::WarpField;
use crate::error::EngineError;
use crate::scene::{Gaussians, Motion};

/// Moments that are kept when no other number is asked for: two clips of eight frames.
const DEFAULT_CACHED_TIMES: usize = 16;

/// What moves the splats.
#[derive(Debug)]
enum Mover {
    Network(Box<Network>),
    Paths(PathField),
    Sequence(Sequence),
    Warp(Box<WarpField>),
}

/// Canonical splats on the device with what moves them.
#[derive(Debug)]
pub struct DeformField {
    device: Device,
    canonical: Arc<SplatState>,
    /// `None` for a scene that stands still.
    mover: Option<Mover>,
    cached: Latest,
    kept: KeptTimes,
}

/// Which moments are kept.
#[derive(Clone, Copy, Debug)]
struct KeptTimes {
    /// As many in any case.
    least: usize,
    /// And more, as long as all of them hold so many bytes.
    bytes: usize,
}

impl DeformField {
    /// Uploads a scene.
    ///
    /// # Errors
    /// When device memory runs out.
    pub fn new(device: &Device, gaussians: &Gaussians, motion: &Motion) -> Result<Self, EngineError> {
        let canonical = Arc::new(SplatState::upload(device, gaussians)?);
        let mover = match motion {
            Motion::Still => None,
            Motion::HexPlane(weights) => {
                Some(Mover::Network(Box::new(Network::new(device, weights, canonical.len())?)))
            }
            Motion::Warp(weights) => Some(Mover::Warp(Box::new(WarpField::new(device, weights, gaussians)?))),
            Motion::Paths(paths) => Some(Mover::Paths(PathField::new(device, paths)?)),
            Motion::Sequence(moments) => Some(Mover::Sequence(Sequence::new(gaussians, moments))),
        };
        let kept = KeptTimes { least: DEFAULT_CACHED_TIMES, bytes: 0 };
        Ok(Self { device: device.clone(), canonical, mover, cached: Latest::default(), kept })
    }

    /// What renderers go by that sort by buckets, of a still asset's splats as they were before they were stored as
    /// these. Of a moment of one that moves it follows from what is stored.
    ///
    /// # Errors
    /// When device memory runs out.
    pub(in crate::render) fn with_buckets_of(self, gaussians: &Gaussians) -> Result<Self, EngineError> {
        self.canonical.make_buckets_of(&self.device, &gaussians.means, &gaussians.scales)?;
        Ok(self)
    }

    /// Keeps at most `times` moments, at least one; the least recently used goes first.
    #[must_use]
    pub fn with_cached_times(self, times: usize) -> Self {
        self.with_cached_bytes(times, 0)
    }

    /// Keeps `least` moments, at least one, and more as long as all of them hold at most so many bytes.
    #[must_use]
    pub fn with_cached_bytes(mut self, least: usize, bytes: usize) -> Self {
        self.kept = KeptTimes { least: least.max(1), bytes };
        self.drop_beyond();
        self
    }

    /// Keeps no more than the least number of moments from now on, or if it does so already, one; whether that may be
    /// fewer than before.
    pub fn save_memory(&mut self) -> bool {
        let KeptTimes { least, bytes } = self.kept;
        self.kept = KeptTimes { least: if bytes > 0 { least } else { 1 }, bytes: 0 };
        self.drop_beyond();
        bytes > 0 || least > 1
    }

    /// Drops all moments that are kept; whether there were some.
    pub fn forget_times(&mut self) -> bool {
        let had_some = self.cached.len() > 0;
        self.cached.clear();
        had_some
    }

    /// How many moments are kept.
    #[must_use]
    pub fn num_cached(&self) -> usize {
        self.cached.len()
    }

    /// Device bytes of the moments that are kept.
    #[must_use]
    pub fn cached_bytes(&self) -> usize {
        let moved = self.cached.states().filter(|state| !Arc::ptr_eq(state, &self.canonical));
        moved.map(|state| self.own_bytes(state)).sum()
    }

    fn drop_beyond(&mut self) {
        while self.cached.len() > self.kept.least && self.cached_bytes() > self.kept.bytes {
            self.cached.drop_first();
        }
    }

    /// Device bytes of a moment beside the coefficients that all of them share.
    fn own_bytes(&self, state: &SplatState) -> usize {
        let sh = if Arc::ptr_eq(state.sh_coeffs(), self.sh_coeffs()) { 0 } else { state.sh_coeffs().len() };
        state.geometry_bytes() + size_of::<f32>() * sh
    }

    /// Number of splats.
    #[must_use]
    pub fn len(&self) -> usize {
        self.canonical.len()
    }

    /// Whether there are no splats.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The splats as stored, before any deformation.
    #[must_use]
    pub fn canonical(&self) -> &Arc<SplatState> {
        &self.canonical
    }

    /// SH coefficients of the canonical splats `[N,16,3]`.
    #[must_use]
    pub fn sh_coeffs(&self) -> &Arc<Buffer<f32>> {
        self.canonical.sh_coeffs()
    }

    /// Device bytes of the canonical splats and all cached moments; shared coefficients count once.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<f32>() * self.sh_coeffs().len() + self.own_bytes(&self.canonical) + self.cached_bytes()
    }

    /// The splats at `time` in \[0, 1\]; computed on the first request and cached.
    ///
    /// # Errors
    /// When device memory runs out or the device fails.
    pub fn at(&mut self, time: f32) -> Result<Arc<SplatState>, EngineError> {
        let Some(mover) = self.mover.as_mut().filter(|_| !self.canonical.is_empty()) else {
            return Ok(Arc::clone(&self.canonical));
        };
        if let Some(state) = self.cached.take_up(time.into()) {
            return Ok(state);
        }
        // Room for it comes first where no more than the least may be kept.
        if self.kept.bytes == 0 && self.cached.len() >= self.kept.least {
            self.cached.drop_first();
        }
        let state = Arc::new(match mover {
            Mover::Network(network) => network.deform(&self.device, &self.canonical, time)?,
            Mover::Paths(paths) => paths.deform(&self.device, &self.canonical, time)?,
            Mover::Warp(warp) => warp.deform(&self.device, &self.canonical, time)?,
            Mover::Sequence(sequence) => sequence.deform(&self.device, time)?,
        });
        self.cached.push(time.into(), &state);
        self.drop_beyond();
        Ok(state)
    }

    /// Even steps from the first moment to the last at whose ends alone splats may change how they move; `None` where
    /// a moment costs next to nothing, or a file says which there are.
    pub(super) fn bends(&self) -> Option<u32> {
        match self.mover.as_ref()? {
            Mover::Network(network) => Some(network.bends()),
            // Of its layers alone, which bend anywhere.
            Mover::Warp(_) => Some(1),
            Mover::Paths(_) | Mover::Sequence(_) => None,
        }
    }

    /// Features and shared layers of the network at `time`; `None` for a scene without one.
    ///
    /// # Errors
    /// As [`DeformField::at`].
    pub fn hidden(&mut self, time: f32) -> Result<Option<HiddenRows>, EngineError> {
        let Some(Mover::Network(network)) = self.mover.as_mut() else { return Ok(None) };
        network.hidden(&self.device, &self.canonical, time).map(Some)
    }
}
