//! 2D convolution with square filters at stride 1: the product of an image's windows with the filters.
//!
//! The kernels are those of `nn/matmul`, whose variant `windows` takes the rows of its left operand from the image as
//! it goes. A convolution with a larger stride becomes one of stride 1 when the pixels of a stride are stacked, see
//! `image/crop`.

use super::activation::Activation;
use super::check::{expect_len, shape_error};
use super::matmul::{Epilogue, Product, Windows, of_windows};
use super::pack::{LANES, PackedWeight};
use crate::error::KernelError;
use crate::shape::require_len;
use crate::vk::{Buffer, Device, Recorder};

const KERNEL: &str = "nn/conv2d";

/// Filters as `PyTorch`'s Conv2d has them.
#[derive(Clone, Copy, Debug)]
pub struct FilterBank<'a> {
    /// `[out_channels, in_channels, taps, taps]`
    pub weight: &'a [f32],
    /// `[out_channels]`
    pub bias: &'a [f32],
    /// `Co`
    pub out_channels: usize,
    /// `Ci`
    pub in_channels: usize,
    /// Side of a filter in pixels.
    pub taps: usize,
}

/// Filters on the device, for both directions.
#[derive(Debug)]
pub struct Filters {
    forward: PackedWeight,
    adjoint: PackedWeight,
    bias: Buffer<f32>,
    taps: usize,
}

impl Filters {
    /// Packs a bank of filters.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when a length does not fit; when memory runs out.
    pub fn new(device: &Device, name: &str, bank: &FilterBank) -> Result<Self, KernelError> {
        let FilterBank { weight, bias, out_channels, in_channels, taps } = *bank;
        expect_len(KERNEL, "weight", weight.len(), out_channels * in_channels * taps * taps, "Co*Ci*taps*taps")?;
        expect_len(KERNEL, "bias", bias.len(), out_channels, "Co")?;
        let (stored_in, stored_out) = (stored(in_channels), stored(out_channels));
        let area = taps * taps;
        let mut forward = vec![0.0; out_channels * area * stored_in];
        let mut adjoint = vec![0.0; in_channels * area * stored_out];
        for (i, value) in weight.iter().enumerate() {
            let (output, input, tap) = (i / (in_channels * area), i / area % in_channels, i % area);
            forward[(output * area + tap) * stored_in + input] = *value;
            adjoint[(input * area + area - 1 - tap) * stored_out + output] = *value;
        }
        let mut padded_bias = bias.to_vec();
        padded_bias.resize(stored_out, 0.0);
        let adjoint_name = format!("{name}.adjoint");
        Ok(Self {
            forward: PackedWeight::new(device, name, &forward, out_channels, area * stored_in)?,
            adjoint: PackedWeight::new(device, &adjoint_name, &adjoint, in_channels, area * stored_out)?,
            bias: device.buffer_from(&format!("{name}.bias"), &padded_bias)?,
            taps,
        })
    }

    /// Channels of an input pixel in memory: `Ci` rounded up to a multiple of 8.
    #[must_use]
    pub fn in_channels(&self) -> usize {
        self.adjoint.n()
    }

    /// Channels of an output pixel in memory: `Co` rounded up to a multiple of 8.
    #[must_use]
    pub fn out_channels(&self) -> usize {
        self.forward.n()
    }
}

/// Channels as they lie in memory, with zeros at the end.
fn stored(channels: usize) -> usize {
    channels.next_multiple_of(LANES)
}

/// Sizes of one convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv2d {
    /// Images.
    pub frames: usize,
    /// Of an input image.
    pub height: usize,
    /// Of an input image.
    pub width: usize,
    /// Zeros on every side, fewer than taps.
    pub padding: usize,
}

impl Conv2d {
    /// Height and width of an output image; 0 where the filter does not fit.
    #[must_use]
    pub fn out_size(&self, taps: usize) -> (usize, usize) {
        let outputs = |size: usize| (size + 2 * self.padding + 1).saturating_sub(taps);
        (outputs(self.height), outputs(self.width))
    }

    /// Refuses a filter that does not fit; gives height and width of an output image.
    fn checked_size(&self, taps: usize) -> Result<(usize, usize), KernelError> {
        let (height, width) = self.out_size(taps);
        if self.padding < taps && height > 0 && width > 0 {
            return Ok((height, width));
        }
        let got = format!("{} in {} x {} with padding {}", taps, self.height, self.width, self.padding);
        Err(shape_error(KERNEL, "taps", got, "more than the padding, and no more than the padded image".to_owned()))
    }
}

/// `y = act(filters * x + bias)`.
///
/// # Shapes
/// in `x` \[F, H, W, Ci\] or longer · out `y` \[F, H', W', Co\] (=), H' = H + 2 padding + 1 - taps; Ci and Co as in
/// [`Filters::in_channels`] and [`Filters::out_channels`]
/// # Equation: cross-correlation with zero padding, as `PyTorch`'s Conv2d
/// # Determinism: bitwise; every element is one sum over rows, columns and channels of its window, in this order
/// # Cost
/// 2·F·H'·W'·taps²·Ci·Co operations and no memory besides `x` and `y`.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    conv: &Conv2d,
    filters: &Filters,
    x: &Buffer<f32>,
    activation: Activation,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let (out_height, out_width) = conv.checked_size(filters.taps)?;
    let channels = filters.in_channels();
    require_len(KERNEL, "x", x.len(), conv.frames * conv.height * conv.width * channels)?;
    let rows = conv.frames * out_height * out_width;
    expect_len(KERNEL, "y", y.len(), rows * filters.out_channels(), "F*H'*W'*Co")?;
    let windows = Windows {
        height: conv.height,
        width: conv.width,
        out_height,
        out_width,
        channels,
        taps: filters.taps,
        padding: conv.padding,
    };
    let epilogue = Epilogue::Activate(activation);
    let product = Product { a: x, rows, weight: &filters.forward, bias: Some(&filters.bias), epilogue };
    of_windows(rec, &product, windows, y)
}

/// Gradient to the input.
///
/// # Shapes
/// in `v_y` \[F, H', W', Co\] · `gate` \[F, H, W, Ci\] or longer · out `v_x` \[F, H, W, Ci\] (=)
/// # Equation: the filters turned by 180° over `v_y`, zero where `gate` is not above 0: with `gate` = x behind a ReLU
/// the gradient of that ReLU's input
/// # Determinism: bitwise, as [`forward`]
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    conv: &Conv2d,
    filters: &Filters,
    v_y: &Buffer<f32>,
    gate: Option<&Buffer<f32>>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let (height, width) = conv.checked_size(filters.taps)?;
    let channels = filters.out_channels();
    expect_len(KERNEL, "v_y", v_y.len(), conv.frames * height * width * channels, "F*H'*W'*Co")?;
    let rows = conv.frames * conv.height * conv.width;
    expect_len(KERNEL, "v_x", v_x.len(), rows * filters.in_channels(), "F*H*W*Ci")?;
    let windows = Windows {
        height,
        width,
        out_height: conv.height,
        out_width: conv.width,
        channels,
        taps: filters.taps,
        padding: filters.taps - 1 - conv.padding,
    };
    let epilogue = match gate {
        Some(gate) => Epilogue::Grad(Activation::Relu, gate),
        None => Epilogue::Activate(Activation::Identity),
    };
    let product = Product { epilogue, ..Product::plain(v_y, rows, &filters.adjoint) };
    of_windows(rec, &product, windows, v_x)
}
