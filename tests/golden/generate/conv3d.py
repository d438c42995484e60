"""Golden of nn/conv3d: PyTorch's 3x3x3 convolution with zero padding, and with replicate-temporal/reflect-spatial."""

import torch
import torch.nn.functional as F
from common import save

generator = torch.Generator().manual_seed(0)
FRAMES, HEIGHT, WIDTH, CHANNELS_IN, CHANNELS_OUT = 3, 5, 7, 4, 8


def random(*shape):
    return torch.rand(shape, generator=generator) * 2 - 1


def pad_clip(x):
    """One step on every side of [1, C, F, H, W]: replicate in time, reflect in space."""
    x = F.pad(x, (0, 0, 0, 0, 1, 1), mode="replicate")
    return F.pad(x, (1, 1, 1, 1, 0, 0), mode="reflect")


def channels_last(x):
    return x[0].permute(1, 2, 3, 0).contiguous()


tensors = {}
x = random(1, CHANNELS_IN, FRAMES, HEIGHT, WIDTH)
weight = random(CHANNELS_OUT, CHANNELS_IN, 3, 3, 3)
bias = random(CHANNELS_OUT)
v_y = random(1, CHANNELS_OUT, FRAMES, HEIGHT, WIDTH)
tensors.update(x=channels_last(x), weight=weight, bias=bias, v_y=channels_last(v_y))
for name in ("zero", "clip"):
    leaves = [t.clone().requires_grad_() for t in (x, weight, bias)]
    y = F.conv3d(leaves[0], leaves[1], leaves[2], padding=1) if name == "zero" else F.conv3d(pad_clip(leaves[0]), *leaves[1:])
    y.backward(v_y)
    tensors[f"{name}.y"] = channels_last(y)
    tensors[f"{name}.v_x"] = channels_last(leaves[0].grad)
    tensors[f"{name}.v_weight"] = leaves[1].grad
    tensors[f"{name}.v_bias"] = leaves[2].grad
save("conv3d", tensors)
