"""Other implementations beside guard4d: one table of the same work, measured in one run. `./x peers` calls it.

Nothing of guard4d needs this file or Python; it is here because the peers are Python packages.
"""

import argparse
import csv
import datetime
import importlib
import importlib.util
import json
import math
import os
import pathlib
import platform
import re
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

# Threads that wait for work must not count as CPU time; read when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numpy as np  # noqa: E402
import torch  # noqa: E402
from torch import nn  # noqa: E402
from torch.nn import functional  # noqa: E402
from torch.utils import cpp_extension  # noqa: E402

# A machine without a network may lack it.
ncnn = importlib.import_module("ncnn") if importlib.util.find_spec("ncnn") else None

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Of each row at least this many samples, and more where they are short.
SAMPLES = 10
SECONDS = 2.0
WARM_UP = 1
# Rows of the transformer products: eight images of fifty tokens. guard4d's own row names carry the same sizes.
ROWS = 400
PRODUCTS = [(768, 768), (2304, 768), (3072, 768), (768, 3072)]
CONVOLUTIONS = [(16, 16), (3, 16)]
CLIP_SHAPE = (8, 224, 224)
IMAGES = 8
VIT = {"layers": 12, "width": 768, "heads": 12, "inner": 3072, "tokens": 50, "patch": 32, "features": 512}
# The scenes of benches/kernels/splat.rs that gsplat draws, too.
SCENES = ["50k, 800x800", "30k, 800x800"]
# How many times as fast as gsplat guard4d's splats are meant to be drawn.
GSPLAT_TARGET = 2.0
# Largest mean difference of gsplat's picture to guard4d's. Alpha ends at 0.999 and not at 0.99, and splats end a little
# elsewhere: 3e-5 in parts of the pictures, by gsplat's reference in PyTorch. A shift by half a pixel makes 0.03.
PICTURE_TOLERANCE = 1e-3
# Largest error of a peer's product against float64, as a share of the largest value: sums of 3072 rounded products.
TOLERANCE = 1e-4
COLUMNS = [
    "work", "peer", "precision", "samples", "wall_ms_best", "wall_ms", "cpu_ms_best", "cpu_ms",
    "gflop", "wall_gflops", "cpu_gflops", "guard4d_wall_percent", "guard4d_cpu_percent",
]  # fmt: skip


def wall_seconds(once):
    """Seconds by the clock on the wall."""
    start = time.perf_counter()
    once()
    return time.perf_counter() - start


def cuda_seconds(once):
    """Seconds by the clock of NVIDIA's device."""
    start, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
    start.record()
    once()
    end.record()
    torch.cuda.synchronize()
    return start.elapsed_time(end) / 1e3


def measure(once, clock):
    """Seconds by a clock and CPU seconds of each run; CPU time is of all threads, a software driver's among them."""
    for _ in range(WARM_UP):
        once()
    wall, cpu = [], []
    while len(wall) < SAMPLES or sum(wall) < SECONDS:
        start = time.process_time()
        wall.append(clock(once))
        cpu.append(time.process_time() - start)
    return wall, cpu


def row(work, peer, precision, flops, once, clock=wall_seconds):
    """One line of the table."""
    wall, cpu = measure(once, clock)
    print(f"{work}, {peer} {precision}: {1e3 * min(wall):.2f} ms", file=sys.stderr)
    times = [min(wall), statistics.median(wall), min(cpu), statistics.median(cpu)]
    return line(work, (peer, precision, len(wall)), [1e3 * t for t in times], flops)


def line(work, who, times_ms, flops):
    """A line from best and median wall and CPU milliseconds; of work that is no arithmetic, `flops` is `None`."""
    rates = [flops / 1e9, flops / 1e6 / times_ms[1], flops / 1e6 / times_ms[3]] if flops else [None] * 3
    return dict(zip(COLUMNS, [work, *who, *times_ms, *rates], strict=False))


def product_name(n, k):
    return f"nn/matmul {ROWS}x{k}x{n}"


def convolution_name(given, outputs):
    return f"nn/conv3d forward {given}->{outputs}, {'x'.join(map(str, CLIP_SHAPE))}"


def tower_name(way):
    return f"clip/ViT-B/32 {way} {IMAGES} images"


def splat_names(scene):
    """A picture from splats alone, and its last part: what blends lists of splats to pixels."""
    return f"splat/forward {scene}", f"splat/rasterize forward {scene}"


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
    """Linear layers, convolutions and the image tower in torch, on the processor ("cpu") or on NVIDIA's device ("cuda")."""
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


def read_tensors(path):
    """Tensors of a safetensors file of 32-bit floats."""
    data = path.read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    out = {}
    for name, entry in json.loads(data[8:start]).items():
        if entry["dtype"] != "F32":
            raise RuntimeError(f"{path}: {name} is {entry['dtype']}, not F32")
        begin, end = (start + offset for offset in entry["data_offsets"])
        out[name] = torch.from_numpy(np.frombuffer(data[begin:end], "<f4").reshape(entry["shape"]).copy())
    return out


def gsplat_arguments(scene):
    """A scene that `./x bench` wrote, as gsplat takes it: one camera, activated scales and opacities."""
    height, width, _ = scene["image"].shape
    given = {name: scene[name] for name in ["means", "quats"]}
    given |= {"scales": scene["scales"].exp(), "opacities": scene["opacities"].sigmoid(), "colors": scene["sh_coeffs"]}
    given |= {"viewmats": scene["viewmat"][None], "Ks": scene["intrinsics"][None], "width": width, "height": height}
    # Of its two ways to hold intermediate results gsplat calls this one the faster.
    return given | {"sh_degree": math.isqrt(scene["sh_coeffs"].shape[1]) - 1, "packed": False}


def gsplat_missing():
    """Why gsplat cannot be measured here, or `None`."""
    if not torch.cuda.is_available():
        return "torch finds no CUDA device"
    if importlib.util.find_spec("gsplat") is None:
        return "gsplat is not installed"
    if not (cpp_extension.CUDA_HOME and shutil.which("nvcc", path=f"{cpp_extension.CUDA_HOME}/bin")):
        return "nvcc, which compiles gsplat, is not installed"
    return None


def gsplat_rows(folder):
    """The scenes in a folder by gsplat: whole pictures by the clock on the wall, blending by the device's."""
    from gsplat import rasterization, rasterize_to_pixels

    rows = []
    for scene in SCENES:
        tensors = read_tensors(folder / f"{scene}.safetensors")
        given = {k: v.cuda() if isinstance(v, torch.Tensor) else v for k, v in gsplat_arguments(tensors).items()}

        def whole():
            picture = rasterization(**given)
            torch.cuda.synchronize()
            return picture

        def blend():
            return rasterize_to_pixels(meta["means2d"], meta["conics"], colors, meta["opacities"], *lists)

        with torch.inference_mode():
            picture, _, meta = whole()
            error = (picture[0].cpu() - tensors["image"][..., :3]).abs().mean().item()
            print(f"gsplat, {scene}: mean difference to guard4d's picture {error:.1e}", file=sys.stderr)
            if not error <= PICTURE_TOLERANCE:
                raise RuntimeError(f"gsplat's picture of {scene} is off by {error} in the mean")
            lists = [meta[name] for name in ["width", "height", "tile_size", "isect_offsets", "flatten_ids"]]
            colors = torch.rand(*meta["means2d"].shape[:-1], 3, device=picture.device)
            first, last = splat_names(scene)
            rows.append(row(first, "gsplat CUDA", "f32", None, whole))
            rows.append(row(last, "gsplat CUDA", "f32", None, blend, cuda_seconds))
    return rows


def splat_verdicts(rows):
    """How guard4d's splats stand to the target, by best times: a sentence for each row of gsplat."""
    for r in rows:
        if r["peer"] == "gsplat CUDA":
            times = r["guard4d_wall_percent"] / 100
            verdict = "met" if times >= GSPLAT_TARGET else "not met"
            yield f"{r['work']}: guard4d is {times:.2f} times as fast as gsplat; at least {GSPLAT_TARGET:g} is {verdict}"


def guard4d_rows(table):
    """guard4d's own rows of a results file of `./x bench`, with the name of the work that each does."""
    names = [product_name(n, k) for n, k in PRODUCTS] + [convolution_name(*c) for c in CONVOLUTIONS]
    names += [tower_name(way) for way in ["forward", "forward and backward"]]
    splats = [name for scene in SCENES for name in splat_names(scene)]
    names += splats
    rows = []
    for cells in csv.DictReader(table.read_text().splitlines()):
        name = next((n for n in names if cells["name"] == n or cells["name"].startswith(f"{n}, ")), None)
        if name is None:
            continue
        # What follows the name of other rows says how large the work is.
        precision = "f32" if name in splats else cells["name"][len(name) + 2 :] or "f32"
        times = [float(cells[c]) for c in ["best_ms", "ms", "best_core_ms", "core_ms"]]
        flops = None if name in splats else float(cells["rate"]) * 1e6 * times[1]
        rows.append(line(name, ("guard4d", precision, int(cells["samples"])), times, flops))
    missing = set(names) - {r["work"] for r in rows}
    if missing:
        raise RuntimeError(f"{table} has no row for {sorted(missing)}")
    return rows


def compare(rows):
    """What guard4d's f32 reaches of each peer's speed, from best times, and in which order rows stand."""
    ours = {r["work"]: r for r in rows if r["peer"] == "guard4d" and r["precision"] == "f32"}
    for r in rows:
        own = ours[r["work"]]
        r["guard4d_wall_percent"] = 100 * r["wall_ms_best"] / own["wall_ms_best"]
        r["guard4d_cpu_percent"] = 100 * r["cpu_ms_best"] / own["cpu_ms_best"]
    return sorted(rows, key=lambda r: list(ours).index(r["work"]))


def text(value):
    if value is None:
        return ""
    return f"{value:.2f}" if isinstance(value, float) else str(value)


NOTES = """\
Best and median of the samples; CPU time is that of all threads of the process, a software driver's among them. The
last two columns are guard4d's f32 speed as a share of the row's, from the best times: 50 means that guard4d takes twice
as long.

- **torch CUDA** is there where an NVIDIA device is; guard4d's rows are of the Vulkan device that `./x bench` takes.
- **torch** runs oneDNN and MKL kernels made for this processor, with fused multiply-add in vectors as wide as it has;
  bf16 is fast only where the processor has instructions for it. **guard4d** and **ncnn** go through Mesa's lavapipe,
  which compiles to vectors of 256 bits at most and contracts no multiplication and addition: of the peak of 256-bit
  FMA that leaves half, of 512-bit FMA a quarter. The goal for the products is 18 % of torch f32's speed.
- Where other programs share the cores, wall times are too long, and most for torch, whose threads wait for one another;
  then the shares by CPU time are the ones to read.
- guard4d's wall times are the device's own timestamps around its passes, torch's and ncnn's are around the call. ncnn's
  call also copies input and output to and from the device's layout, which is little beside these times.
- guard4d evaluates the last layer of the tower for the one token that CLIP reads, torch for all; both count the full
  layer as work. guard4d's convolution pads by reflection and repetition, torch's with zeros; both end in a ReLU.
- **gsplat** is there where CUDA is; it draws the file that guard4d's benchmark wrote of its scene, and its picture is
  compared with guard4d's. `splat/forward` is a picture from splats alone, by the clock on the wall for both, with all that
  the host waits for and allocates; `splat/rasterize forward` blends lists that are there, by the device's clock for both.
  guard4d's embedding makes lists once and blends them in every step.
- "its default, 16-bit" is what ncnn does unless told otherwise: storage and arithmetic in 16-bit floats where the
  device says that it has them.
"""


def markdown(rows, args, device):
    """The table that people read."""
    versions = f"torch {torch.__version__} ({torch.get_num_threads()} threads)"
    versions += f", ncnn {ncnn.__version__}" if ncnn else "; no ncnn here"
    head = [c.replace("_", " ") for c in COLUMNS]
    out = [
        "# Peers beside guard4d, one run on one machine\n",
        f"- Processor: {processor()}; load before the run: {args.load}",
        f"- Versions: {versions}, Python {platform.python_version()}; Vulkan device of guard4d and ncnn: {device}",
        f"- Commit: {args.commit}; command: `./x peers`, which runs `./x bench {shlex.join(args.filters)}`",
        f"- Date: {datetime.datetime.now(datetime.UTC):%F}",
        f"- {args.gsplat}\n",
        NOTES,
        f"| {' | '.join(head)} |",
        f"| {' | '.join(['---'] * 3 + ['---:'] * (len(COLUMNS) - 3))} |",
    ]
    out += [f"| {' | '.join(text(r[c]) for c in COLUMNS)} |" for r in rows]
    return "\n".join(out) + "\n"


def processor():
    lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.split(": ")[1] for line in lines if line.startswith("model name")), platform.machine())
    flags = next((line.split() for line in lines if line.startswith("flags")), [])
    vectors = [flag for flag in ["avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16"] if flag in flags]
    return f"{model}, {os.cpu_count()} threads; of vector extensions it has {', '.join(vectors) or 'none of note'}"


def device_name(folder):
    """The Vulkan device, as the benchmark's own summary names it."""
    lines = (folder / "summary.md").read_text().splitlines()
    return next(line for line in lines if line.startswith("- Device: ")).removeprefix("- Device: ").split(";")[0]


def results(device):
    """Where today's results on a device go: the folder that `./x bench` takes, too."""
    slug = "-".join(re.findall("[a-z0-9]+", device.lower()))
    return ROOT / "benches/results" / f"{datetime.datetime.now(datetime.UTC):%F}-{slug}"


def main():
    parser = argparse.ArgumentParser(prog="./x peers", description=__doc__)
    parser.add_argument("--out", type=pathlib.Path, help="folder for the tables [default: benches/results/DATE-DEVICE]")
    parser.add_argument("--benches", type=pathlib.Path, help="guard4d's benchmarks as `./x gpu --build` packed them")
    args = parser.parse_args()
    args.load = " ".join(f"{v:.2f}" for v in os.getloadavg()[:2])
    head = ["git", "-C", ROOT, "rev-parse", "HEAD"]
    args.commit = subprocess.run(head, capture_output=True, text=True, check=True).stdout.strip()
    args.filters = [f"nn/matmul {ROWS}x", "clip/ViT-B/32", "nn/conv3d forward"]
    args.filters += [name for scene in SCENES for name in splat_names(scene)]
    torch.manual_seed(0)
    # guard4d between the peers, so that a drift of the machine does not favour one of them alone.
    rows = torch_rows("cpu", [("f32", torch.float32), ("bf16", torch.bfloat16)])
    if torch.cuda.is_available():
        rows += torch_rows("cuda", [("f32", torch.float32), ("f16", torch.float16), ("bf16", torch.bfloat16)])
    with tempfile.TemporaryDirectory() as folder:
        program = [args.benches, "--bench"] if args.benches else [ROOT / "x", "bench"]
        subprocess.run([*program, *args.filters, "--out", folder, "--scenes", folder], check=True)
        rows += guard4d_rows(pathlib.Path(folder, "results.csv"))
        device = device_name(pathlib.Path(folder))
        missing = gsplat_missing()
        rows += [] if missing else gsplat_rows(pathlib.Path(folder))
    if ncnn and ncnn.get_gpu_count():
        rows += ncnn_rows()
    else:
        print("no ncnn, or no Vulkan device that it finds: no rows of it", file=sys.stderr)
    rows = compare(rows)
    args.gsplat = f"gsplat: not measured, because {missing}" if missing else "; ".join(splat_verdicts(rows))
    print(args.gsplat)
    out = args.out or results(device)
    out.mkdir(parents=True, exist_ok=True)
    with (out / "peers.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows({c: text(r[c]) for c in COLUMNS} for r in rows)
    (out / "peers.md").write_text(markdown(rows, args, device))
    print(out / "peers.md")


if __name__ == "__main__":
    main()
