//! Antialiased bilinear resize of clips, and its adjoint.

use super::frames::{CHANNELS, frames_grid};
use crate::error::KernelError;
use crate::registry::image::resize_apply;
use crate::shape::{dim_signed, expect_len};
use crate::vk::{Buffer, Device, Recorder};

const KERNEL: &str = "image/resize";

/// Height and width in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSize {
    /// `H`
    pub height: usize,
    /// `W`
    pub width: usize,
}

/// A rectangle of a picture, in pixels from the picture's upper left corner; it may reach beyond the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Left edge.
    pub x: f64,
    /// Upper edge.
    pub y: f64,
    /// From the left to the right edge; positive.
    pub width: f64,
    /// From the upper to the lower edge; positive.
    pub height: f64,
}

impl Region {
    /// All of a picture.
    #[must_use]
    pub fn whole(size: ImageSize) -> Self {
        Self { x: 0.0, y: 0.0, width: size.width as f64, height: size.height as f64 }
    }

    fn is_sound(self) -> bool {
        let Self { x, y, width, height } = self;
        [x, y, width, height].iter().all(|v| v.is_finite()) && width > 0.0 && height > 0.0
    }
}

/// A part of an axis.
#[derive(Clone, Copy)]
struct Span {
    first: f64,
    length: f64,
}

/// Weights of one output entry over consecutive inputs.
struct Window {
    first: usize,
    weights: Vec<f64>,
}

/// The windows of `ATen`'s antialiased bilinear kernel with `align_corners=True`: scale
/// (in−1)/(out−1), centre scale·(i+½), a triangle as wide as the scale, clipped and renormalised. `in` is the length of
/// `span`, which begins elsewhere than at 0. What looks at nothing but the outside sees the outermost pixel.
fn windows(from: usize, to: usize, span: Span) -> Vec<Window> {
    let scale = if to > 1 { (span.length - 1.0).max(0.0) / (to - 1) as f64 } else { 0.0 };
    let support = scale.max(1.0);
    let window = |i: usize| {
        let center = span.first + scale * (i as f64 + 0.5);
        let first = (center - support + 0.5).max(0.0).floor();
        let end = (center + support + 0.5).floor().min(from as f64);
        let mut weights = Vec::new();
        let mut at = first;
        while at < end {
            weights.push((1.0 - ((at - center + 0.5) / support).abs()).max(0.0));
            at += 1.0;
        }
        let total: f64 = weights.iter().sum();
        // Weights are shares of at least a few thousandths, or nothing.
        if weights.is_empty() || total <= 0.0 {
            return Window { first: if center < 0.0 { 0 } else { from - 1 }, weights: vec![1.0] };
        }
        weights.iter_mut().for_each(|w| *w /= total);
        Window { first: index(first), weights }
    };
    (0..to).map(window).collect()
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a whole number within the axis")]
fn index(position: f64) -> usize {
    position as usize
}

/// For each input of `windows` the outputs it feeds.
fn transposed(windows: &[Window], from: usize) -> Vec<Window> {
    let mut columns: Vec<Window> = (0..from).map(|_| Window { first: 0, weights: Vec::new() }).collect();
    for (o, window) in windows.iter().enumerate() {
        for (i, &weight) in (window.first..).zip(&window.weights).filter(|(_, w)| **w > 0.0) {
            let column = &mut columns[i];
            if column.weights.is_empty() {
                column.first = o;
            }
            column.weights.resize(o - column.first, 0.0);
            column.weights.push(weight);
        }
    }
    columns
}

/// Windows on the device: per output a texel with the first index, then the weights. One table after the other.
#[derive(Debug)]
struct Table {
    rows: Buffer<f32>,
    taps4: usize,
    tables: usize,
}

impl Table {
    #[allow(clippy::cast_possible_truncation, reason = "weights are stored as f32; indices are below 2^24")]
    fn new(device: &Device, name: &str, tables: &[Vec<Window>]) -> Result<Self, KernelError> {
        let windows = || tables.iter().flatten();
        let taps4 = windows().map(|w| w.weights.len().div_ceil(4)).max().unwrap_or(0).max(1);
        let mut rows = Vec::with_capacity(windows().count() * (1 + taps4) * 4);
        for window in windows() {
            rows.extend([window.first as f32, 0.0, 0.0, 0.0]);
            rows.extend(window.weights.iter().map(|w| *w as f32));
            rows.resize(rows.len() + taps4 * 4 - window.weights.len(), 0.0);
        }
        Ok(Self { rows: device.buffer_from(name, &rows)?, taps4, tables: tables.len() })
    }
}

/// Weight tables of one axis in both directions.
#[derive(Debug)]
struct Axis {
    forward: Table,
    backward: Table,
}

impl Axis {
    fn of(device: &Device, from: usize, windows: &[Vec<Window>]) -> Result<Self, KernelError> {
        let transposed: Vec<_> = windows.iter().map(|windows| transposed(windows, from)).collect();
        Ok(Self {
            forward: Table::new(device, "resize.forward", windows)?,
            backward: Table::new(device, "resize.backward", &transposed)?,
        })
    }
}

/// A Gaussian, cut off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blur {
    /// Standard deviation in pixels.
    pub sigma: f64,
    /// Taps on each side of the middle one.
    pub radius: usize,
}

/// A resize from one size to another, or a blur: a matrix along each axis that is zero far from its diagonal.
#[derive(Debug)]
pub struct ResizePlan {
    /// Input size.
    pub from: ImageSize,
    /// Output size.
    pub to: ImageSize,
    vertical: Axis,
    horizontal: Axis,
}

/// A Gaussian of `radius` taps on each side, normalised; beyond the border the picture is mirrored about its last
/// pixel.
fn gaussian(n: usize, sigma: f64, radius: usize) -> Vec<Window> {
    let weight = |d: usize| (-0.5 * (d as f64 / sigma).powi(2)).exp();
    let total = weight(0) + 2.0 * (1..=radius).map(weight).sum::<f64>();
    // Mirrored as often as it takes; a period is there and back.
    let period = (2 * n).saturating_sub(2).max(1);
    let mirrored = |i: usize| {
        let i = i % period;
        if i < n { i } else { period - i }
    };
    (0..n)
        .map(|i| {
            let (first, last) = (i.saturating_sub(radius), (i + radius).min(n - 1));
            let mut weights = vec![0.0; last - first + 1];
            for k in 0..=2 * radius {
                let source = mirrored(i + k + period * radius.div_ceil(period) - radius);
                weights[source - first] += weight(k.abs_diff(radius)) / total;
            }
            Window { first, weights }
        })
        .collect()
}

impl ResizePlan {
    /// A Gaussian blur at the same size.
    ///
    /// # Errors
    /// [`KernelError::Shape`] for an empty image or a blur that is no positive number; when memory runs out.
    pub fn blur(device: &Device, size: ImageSize, blur: Blur) -> Result<Self, KernelError> {
        if size.height == 0 || size.width == 0 || !(blur.sigma.is_finite() && blur.sigma > 0.0) {
            let got = format!("{blur:?} of {} x {}", size.height, size.width);
            let expected = "a pixel, and a positive sigma".to_owned();
            return Err(KernelError::Shape { kernel: KERNEL, buffer: "blur", got, expected });
        }
        let axis = |n| Axis::of(device, n, &[gaussian(n, blur.sigma, blur.radius)]);
        Ok(Self { from: size, to: size, vertical: axis(size.height)?, horizontal: axis(size.width)? })
    }

    /// Computes the weight tables.
    ///
    /// # Errors
    /// [`KernelError::Shape`] for an empty image; when memory runs out.
    pub fn new(device: &Device, from: ImageSize, to: ImageSize) -> Result<Self, KernelError> {
        Self::regions(device, from, to, &[Region::whole(from)])
    }

    /// A part of each frame brought to a size: one region for every frame of the clips, or one for all.
    ///
    /// # Errors
    /// [`KernelError::Shape`] for an empty image, no region, or one that is not finite and positive; when memory runs
    /// out.
    pub fn regions(device: &Device, from: ImageSize, to: ImageSize, regions: &[Region]) -> Result<Self, KernelError> {
        for (buffer, size) in [("from", from), ("to", to)] {
            if size.height == 0 || size.width == 0 {
                let got = format!("{} x {}", size.height, size.width);
                return Err(KernelError::Shape { kernel: KERNEL, buffer, got, expected: "a pixel".to_owned() });
            }
        }
        if regions.is_empty() || !regions.iter().all(|region| region.is_sound()) {
            let (got, expected) = (format!("{regions:?}"), "finite regions of positive sides".to_owned());
            return Err(KernelError::Shape { kernel: KERNEL, buffer: "regions", got, expected });
        }
        let rows = |r: &Region| windows(from.height, to.height, Span { first: r.y, length: r.height });
        let columns = |r: &Region| windows(from.width, to.width, Span { first: r.x, length: r.width });
        Ok(Self {
            from,
            to,
            vertical: Axis::of(device, from.height, &regions.iter().map(rows).collect::<Vec<_>>())?,
            horizontal: Axis::of(device, from.width, &regions.iter().map(columns).collect::<Vec<_>>())?,
        })
    }

    /// Working memory for clips of `frames` frames.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn scratch(&self, device: &Device, frames: usize) -> Result<Buffer<f32>, KernelError> {
        device.buffer("resize.scratch", frames * self.to.height * self.from.width * CHANNELS)
    }

    fn check(&self, frames: usize, buffers: [(&'static str, &Buffer<f32>); 3]) -> Result<(), KernelError> {
        let [(large_name, large), (small_name, small), (scratch_name, scratch)] = buffers;
        let tables = self.vertical.forward.tables;
        if tables != 1 && tables != frames {
            let expected = format!("{tables}, one for each region");
            return Err(KernelError::Shape { kernel: KERNEL, buffer: "frames", got: frames.to_string(), expected });
        }
        expect_len(KERNEL, large_name, large, frames * self.from.height * self.from.width * CHANNELS)?;
        expect_len(KERNEL, small_name, small, frames * self.to.height * self.to.width * CHANNELS)?;
        expect_len(KERNEL, scratch_name, scratch, frames * self.to.height * self.from.width * CHANNELS)
    }
}

/// What becomes of a gradient before [`backward`] writes it: one pass instead of three over full-size clips.
#[derive(Clone, Copy, Debug, Default)]
pub struct Onward<'a> {
    /// Gradient `[F,H,W,4]` of other readers of the input, added.
    pub plus: Option<&'a Buffer<f32>>,
    /// What the input was clamped to \[0, 1\] from, `[F,H,W,4]`: nothing passes where it lies outside, or is NaN. Both
    /// ends pass, as in PyTorch's `clamp`.
    pub clamped: Option<&'a Buffer<f32>>,
}

/// Sizes of one pass over `[planes, from, inner, 4]`.
struct Pass<'a> {
    planes: usize,
    from: usize,
    to: usize,
    inner: usize,
    onward: Onward<'a>,
}

fn apply(
    rec: &mut Recorder,
    pass: &Pass<'_>,
    table: &Table,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let params = resize_apply::Params {
        planes: dim_signed(pass.planes),
        from: dim_signed(pass.from),
        to: dim_signed(pass.to),
        inner: dim_signed(pass.inner),
        taps4: dim_signed(table.taps4),
        // An empty clip has no plane, and no invocation that would divide by this.
        planes_per_table: dim_signed((pass.planes / table.tables).max(1)),
    };
    let grid = frames_grid(pass.to * pass.inner, pass.planes, resize_apply::KERNEL.local_size[0]);
    let Onward { plus, clamped } = pass.onward;
    let spec = resize_apply::Spec { add: u32::from(plus.is_some()), gate: u32::from(clamped.is_some()) };
    // What is not there is not read.
    let (plus, clamped) = (plus.unwrap_or(x), clamped.unwrap_or(x));
    let bind = resize_apply::Bind { x, table: &table.rows, plus, clamped, y };
    rec.dispatch_spec(bind, params, spec, grid)
}

/// Resizes a clip, rows first, then columns.
///
/// # Shapes
/// in `x` \[F,H,W,4\] · out `y` \[F,h,w,4\] (=), fourth channel 0 · `scratch` \[F,h,W,4\] (=)
/// # Equation: PyTorch's `interpolate(mode="bilinear", antialias=True, align_corners=True)`
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    plan: &ResizePlan,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
    scratch: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let frames = x.len() / (plan.from.height * plan.from.width * CHANNELS);
    plan.check(frames, [("x", x), ("y", y), ("scratch", scratch)])?;
    let onward = Onward::default();
    let ImageSize { height, width } = plan.from;
    let pass = Pass { planes: frames, from: height, to: plan.to.height, inner: width, onward };
    apply(rec, &pass, &plan.vertical.forward, x, scratch)?;
    let planes = frames * plan.to.height;
    let pass = Pass { planes, from: width, to: plan.to.width, inner: 1, onward };
    apply(rec, &pass, &plan.horizontal.forward, scratch, y)
}

/// Gradient to the input: the exact adjoint of [`forward`], then [`Onward`].
///
/// # Shapes
/// in `v_y` \[F,h,w,4\] · `onward` · out `v_x` \[F,H,W,4\] (=), fourth channel 0 · `scratch` \[F,h,W,4\] (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    plan: &ResizePlan,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
    onward: Onward<'_>,
    scratch: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let frames = v_x.len() / (plan.from.height * plan.from.width * CHANNELS);
    plan.check(frames, [("v_x", v_x), ("v_y", v_y), ("scratch", scratch)])?;
    for (name, buffer) in [("plus", onward.plus), ("clamped", onward.clamped)] {
        buffer.map_or(Ok(()), |buffer| expect_len(KERNEL, name, buffer, v_x.len()))?;
    }
    let ImageSize { height, width } = plan.from;
    let planes = frames * plan.to.height;
    let pass = Pass { planes, from: plan.to.width, to: width, inner: 1, onward: Onward::default() };
    apply(rec, &pass, &plan.horizontal.backward, v_y, scratch)?;
    let pass = Pass { planes: frames, from: plan.to.height, to: height, inner: width, onward };
    apply(rec, &pass, &plan.vertical.backward, scratch, v_x)
}
