//! The splats of a scene at any moment, whatever moves them; the latest moments are kept.

use std::sync::Arc;

use guard4d_kernels::{Buffer, Device};

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
    /// Least recently used first.
    cached: Vec<(u32, Arc<SplatState>)>,
    max_cached: usize,
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
        let max_cached = DEFAULT_CACHED_TIMES;
        Ok(Self { device: device.clone(), canonical, mover, cached: Vec::new(), max_cached })
    }

    /// Keeps at most `times` moments, at least one; the least recently used goes first.
    #[must_use]
    pub fn with_cached_times(mut self, times: usize) -> Self {
        self.limit_cached_times(times);
        self
    }

    /// The same for a field in use: what is more than that goes. Whether fewer can be kept than before.
    pub fn limit_cached_times(&mut self, times: usize) -> bool {
        let times = times.max(1);
        self.cached.drain(..self.cached.len().saturating_sub(times));
        std::mem::replace(&mut self.max_cached, times) > times
    }

    /// Drops all moments that are kept.
    pub fn forget_times(&mut self) {
        self.cached.clear();
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
        let shared = self.sh_coeffs();
        let own = |state: &SplatState| {
            let sh = if Arc::ptr_eq(state.sh_coeffs(), shared) { 0 } else { state.sh_coeffs().len() };
            state.geometry_bytes() + size_of::<f32>() * sh
        };
        let cached = self.cached.iter().filter(|(_, s)| !Arc::ptr_eq(s, &self.canonical));
        size_of::<f32>() * shared.len() + own(&self.canonical) + cached.map(|(_, s)| own(s)).sum::<usize>()
    }

    /// The splats at `time` in \[0, 1\]; computed on the first request and cached.
    ///
    /// # Errors
    /// When device memory runs out or the device fails.
    pub fn at(&mut self, time: f32) -> Result<Arc<SplatState>, EngineError> {
        let Some(mover) = self.mover.as_mut().filter(|_| !self.canonical.is_empty()) else {
            return Ok(Arc::clone(&self.canonical));
        };
        let key = time.to_bits();
        let state = match self.cached.iter().position(|(k, _)| *k == key) {
            Some(found) => self.cached.remove(found).1,
            None => {
                if self.cached.len() >= self.max_cached {
                    self.cached.remove(0);
                }
                Arc::new(match mover {
                    Mover::Network(network) => network.deform(&self.device, &self.canonical, time)?,
                    Mover::Paths(paths) => paths.deform(&self.device, &self.canonical, time)?,
                    Mover::Warp(warp) => warp.deform(&self.device, &self.canonical, time)?,
                    Mover::Sequence(sequence) => sequence.deform(&self.device, time)?,
                })
            }
        };
        self.cached.push((key, Arc::clone(&state)));
        Ok(state)
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
