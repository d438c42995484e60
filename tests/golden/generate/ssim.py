"""Golden of loss/ssim: SSIM of 3D Gaussian splatting (11x11 window, sigma 1.5, zero padding) and its gradient, in f64."""

import torch
import torch.nn.functional as F
from common import save

generator = torch.Generator().manual_seed(0)
FRAMES, HEIGHT, WIDTH = 2, 21, 34
C1, C2 = 0.01**2, 0.03**2


def window():
    offsets = torch.arange(11, dtype=torch.float64) - 5
    taps = torch.exp(-(offsets**2) / (2 * 1.5**2))
    taps = taps / taps.sum()
    return torch.outer(taps, taps).expand(3, 1, 11, 11)


def ssim(x, y):
    def mean(image):
        return F.conv2d(image, window(), padding=5, groups=3)

    mx, my = mean(x), mean(y)
    vx, vy, cov = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    return ((2 * mx * my + C1) * (2 * cov + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2))).mean()


def channels_last(x):
    return F.pad(x.permute(0, 2, 3, 1), (0, 1)).contiguous()


# A smooth scene, as renders are, and a small difference, as a mark is; rounded to f32 before use.
coarse = torch.rand((FRAMES, 3, 5, 7), generator=generator)
y = F.interpolate(coarse, size=(HEIGHT, WIDTH), mode="bilinear", align_corners=True)
x = (y + 0.05 * (torch.rand(y.shape, generator=generator) - 0.5)).clamp(0, 1)
x64 = x.double().requires_grad_()
value = ssim(x64, y.double())
value.backward()
save(
    "ssim",
    {"x": channels_last(x), "y": channels_last(y), "value": value.reshape(1), "v_x": channels_last(x64.grad)},
)
