"""Golden of image/resize: PyTorch's interpolate(bilinear, antialias, align_corners) down, up and to one pixel."""

import torch
import torch.nn.functional as F
from common import save

generator = torch.Generator().manual_seed(0)
CASES = {"down": ((37, 50), (11, 8)), "up": ((9, 7), (16, 12)), "one": ((6, 5), (1, 1)), "mixed": ((20, 6), (7, 13))}


def channels_last(x):
    """[F, 3, H, W] to [F, H, W, 4] with a zero fourth channel."""
    return F.pad(x.permute(0, 2, 3, 1), (0, 1)).contiguous()


tensors = {}
for name, (size_from, size_to) in CASES.items():
    x = torch.rand((2, 3, *size_from), generator=generator).requires_grad_()
    v_y = torch.rand((2, 3, *size_to), generator=generator) * 2 - 1
    y = F.interpolate(x, size=size_to, mode="bilinear", align_corners=True, antialias=True)
    y.backward(v_y)
    for key, value in (("x", x), ("y", y), ("v_y", v_y), ("v_x", x.grad)):
        tensors[f"{name}.{key}"] = channels_last(value.detach())
save("resize", tensors)
