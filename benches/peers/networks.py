"""Matrix products, convolutions and CLIP's image tower in PyTorch, and products in ncnn."""

import importlib
import importlib.util
import math
import pathlib
import sys
import tempfile

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from table import row

# A machine without a network may lack it.
ncnn = importlib.import_module("ncnn") if importlib.util.find_spec("ncnn") else None

# Rows of the transformer products: eight images of fifty tokens. guard4d's own row names carry the same sizes.
ROWS = 400
PRODUCTS = [(768, 768), (2304, 768), (3072, 768), (768, 3072)]
CONVOLUTIONS = [(16, 16), (3, 16)]
CLIP_SHAPE = (8, 224, 224)
IMAGES = 8
VIT = {"layers": 12, "width": 768, "heads": 12, "inner": 3072, "tokens": 50, "patch": 32, "features": 512}
# Largest error of a peer's product against float64, as a share of the largest value: sums of 3072 rounded products.
TOLERANCE = 1e-4


def product_name(n, k):
    return f"nn/matmul {ROWS}x{k}x{n}"


def convolution_name(given, outputs):
    return f"nn/conv3d forward {given}->{outputs}, {'x'.join(map(str, CLIP_SHAPE))}"


def tower_name(way):
    return f"clip/ViT-B/32 {way} {IMAGES} images"


class Layer(nn.Module):
    """A transformer layer of CLIP's image tower."""

    def __init__(self):
        super().__init__()
        width = VIT["width"]
        self.norms = nn.ModuleList([nn.LayerNorm(width), nn.LayerNorm(width)])
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.up, self.down = nn.Linear(width, VIT["inner"]), nn.Linear(VIT["inner"], width)

    def forward(self, x):
        batch, tokens, width = x.shape
        heads = self.qkv(self.norms[0](x)).view(batch, tokens, 3, VIT["heads"], width // VIT["heads"])
        query, key, value = heads.permute(2, 0, 3, 1, 4)
        attended = functional.scaled_dot_product_attention(query, key, value)
        x = x + self.out(attended.transpose(1, 2).reshape(batch, tokens, width))
        hidden = self.up(self.norms[1](x))
        return x + self.down(hidden * torch.sigmoid(1.702 * hidden))


class Tower(nn.Module):
    """CLIP's image tower at the size of ViT-B/32, of random weights: pixels to features of unit length."""

    def __init__(self):
        super().__init__()
        width, patch = VIT["width"], VIT["patch"]
        self.patches = nn.Conv2d(3, width, patch, stride=patch, bias=False)
        self.first = nn.Parameter(0.02 * torch.randn(1, 1, width))
        self.positions = nn.Parameter(0.02 * torch.randn(1, VIT["tokens"], width))
        self.before, self.after = nn.LayerNorm(width), nn.LayerNorm(width)
        self.layers = nn.Sequential(*[Layer() for _ in range(VIT["layers"])])
        self.projection = nn.Linear(width, VIT["features"], bias=False)

    def forward(self, pixels):
        patches = self.patches(pixels).flatten(2).transpose(1, 2)
        x = torch.cat([self.first.expand(len(patches), -1, -1), patches], 1) + self.positions
        return functional.normalize(self.projection(self.after(self.layers(self.before(x))[:, 0])), dim=1)


def tower_flops():
    """As benches/pipeline/clip.rs counts them."""
    w, t, patches = VIT["width"], VIT["tokens"], VIT["tokens"] - 1
    layer = t * (8 * w * w + 4 * w * VIT["inner"]) + 4 * t * t * w
    ends = patches * 6 * VIT["patch"] ** 2 * w + 2 * w * VIT["features"]
    return IMAGES * (VIT["layers"] * layer + ends)


def torch_rows(where, precisions):
    """Linear layers, convolutions and the image tower in torch, on the processor, "cpu", or NVIDIA's device, "cuda"."""
    is_cpu = where == "cpu"
    peer = "torch" if is_cpu else "torch CUDA"
    rows = []

    def add(work, precision, flops, once):
        def waited():
            once()
            if not is_cpu:
                torch.cuda.synchronize()

        rows.append(row(work, peer, precision, flops, waited))

    for precision, dtype in precisions:
        to = {"device": where, "dtype": dtype}
        for n, k in PRODUCTS:
            linear, x = nn.Linear(k, n, bias=False).to(**to), torch.rand(ROWS, k).to(**to)
            with torch.inference_mode():
                add(product_name(n, k), precision, 2 * ROWS * n * k, lambda: linear(x))
        # On a processor bf16 is for products; there f32 is what the rest is compared in.
        if is_cpu and dtype != torch.float32:
            continue
        tower = Tower().to(**to).requires_grad_(False)
        pixels = torch.rand(IMAGES, 3, 224, 224).to(**to).requires_grad_()
        upstream = torch.rand(IMAGES, VIT["features"]).to(**to)
        with torch.inference_mode():
            add(tower_name("forward"), precision, tower_flops(), lambda: tower(pixels))
        both = lambda: torch.autograd.grad(tower(pixels), pixels, upstream)  # noqa: E731
        add(tower_name("forward and backward"), precision, 2 * tower_flops(), both)
        for given, outputs in CONVOLUTIONS:
            flops = 2 * 27 * math.prod(CLIP_SHAPE) * given * outputs
            for order, layout in [(torch.contiguous_format, "NCDHW"), (torch.channels_last_3d, "channels last")]:
                conv = nn.Conv3d(given, outputs, 3, padding=1, bias=False).to(**to).to(memory_format=order)
                x = torch.rand(1, given, *CLIP_SHAPE).to(**to).to(memory_format=order)
                with torch.inference_mode():
                    work = convolution_name(given, outputs)
                    add(work, f"{precision} {layout}", flops, lambda: functional.relu_(conv(x)))
    return rows


def ncnn_missing():
    """Why ncnn cannot be measured here, or `None`."""
    if ncnn is None:
        return "it is not installed"
    return None if ncnn.get_gpu_count() else "it finds no Vulkan device"


def ncnn_product(weight, options):
    """A net of one Gemm layer on the first Vulkan device, with the frozen weight `[N, K]`.

    Of ncnn's two layers that do this, InnerProduct took six times as long on lavapipe.
    """
    n, k = weight.shape
    net = ncnn.Net()
    net.opt.use_vulkan_compute = True
    for option, value in options.items():
        setattr(net.opt, option, value)
    with tempfile.TemporaryDirectory() as folder:
        param, weights = pathlib.Path(folder, "net.param"), pathlib.Path(folder, "net.bin")
        # 3: the weight is transposed; 5, 8, 9: it is constant, N and K; 10: nothing is added.
        layers = f"Input a 0 1 a\nGemm gemm 1 1 a y 3=1 5=1 8={n} 9={k} 10=-1\n"
        param.write_text(f"7767517\n2 2\n{layers}")
        # Four zero bytes announce plain floats.
        weights.write_bytes(bytes(4) + weight.tobytes())
        if net.load_param(str(param)) or net.load_model(str(weights)):
            raise RuntimeError("ncnn does not take the Gemm layer")
    if not net.layers()[1].support_vulkan:
        raise RuntimeError("ncnn has no Vulkan kernel for this Gemm layer")
    return net


def ncnn_rows():
    """The same products by ncnn's Vulkan kernels, with the way of input and output to and from the device."""
    floats = dict.fromkeys(["use_fp16_packed", "use_fp16_storage", "use_fp16_arithmetic", "use_bf16_storage"], False)
    rows, random = [], np.random.default_rng(1)
    for n, k in PRODUCTS:
        weight = random.standard_normal((n, k), dtype=np.float32) / np.float32(math.sqrt(k))
        x = random.standard_normal((ROWS, k), dtype=np.float32)
        want = x.astype(np.float64) @ weight.T.astype(np.float64)
        # Its default gains nothing here, and a call takes seconds: once is enough.
        ways = [("f32", floats)] + [("its default, 16-bit", {})] * ((n, k) == PRODUCTS[0])
        for precision, options in ways:
            net = ncnn_product(weight, options)

            def once():
                extractor = net.create_extractor()
                extractor.input("a", ncnn.Mat(x))
                return extractor.extract("y")

            code, got = once()
            error = np.abs(np.array(got) - want).max() / np.abs(want).max() if code == 0 else math.inf
            print(f"ncnn {precision}: largest error {error:.1e} of the largest value", file=sys.stderr)
            if precision == "f32" and not error <= TOLERANCE:
                raise RuntimeError(f"ncnn's product is off by {error}")
            rows.append(row(product_name(n, k), "ncnn Vulkan", precision, 2 * ROWS * n * k, once))
    return rows
