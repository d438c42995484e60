"""Other implementations beside guard4d: one table of the same work, measured in one run. `./x peers` calls it.

Nothing of guard4d needs this folder or Python; it is here because the peers are Python packages.
"""

import argparse
import csv
import datetime
import importlib
import importlib.metadata
import itertools
import json
import os
import pathlib
import platform
import re
import shlex
import subprocess
import sys
import tempfile

# Threads that wait for work must not count as CPU time; read when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import torch  # noqa: E402

import networks  # noqa: E402
import table  # noqa: E402
from marks import mark_rows  # noqa: E402
from splats import SCENES, gsplat_missing, gsplat_rows, metal_gauss_rows, splat_names, splat_verdicts  # noqa: E402

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# What cargo starts programs with, and so are they started here: a driver may bring a C library of its own.
RUNNER = "CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER"
# Packages whose versions are told.
PACKAGES = ["torch", "ncnn", "metal-gauss", "gausscam", "wgpu", "invisible-watermark", "onnxruntime", "gsplat"]


def absent(*modules):
    """Why one of these cannot be imported, or `None`; a machine without a network may lack them."""
    for module in modules:
        try:
            importlib.import_module(module)
        except ImportError as error:
            return str(error)
    return None


# Peers on the processor, on CUDA or on the Vulkan driver that is installed: their name, why they cannot be measured,
# and their rows of a folder of scenes.
PEERS = [
    ("metal-gauss", lambda: absent("metal_gauss"), metal_gauss_rows),
    ("invisible-watermark", lambda: absent("imwatermark", "onnxruntime"), lambda folder: mark_rows()),
    ("gsplat", gsplat_missing, gsplat_rows),
    ("ncnn", networks.ncnn_missing, lambda folder: networks.ncnn_rows()),
]


def filters():
    """Which rows of guard4d's benchmarks have peers."""
    names = [f"nn/matmul {networks.ROWS}x", "clip/ViT-B/32", "nn/conv3d forward"]
    return names + [name for scene in SCENES for name in splat_names(scene)]


def guard4d_rows(results, peer):
    """guard4d's own rows of a results file of `./x bench`, with the name of the work that each does."""
    names = [networks.product_name(n, k) for n, k in networks.PRODUCTS]
    names += [networks.convolution_name(*c) for c in networks.CONVOLUTIONS]
    names += [networks.tower_name(way) for way in ["forward", "forward and backward"]]
    splats = [name for scene in SCENES for name in splat_names(scene)]
    names += splats
    rows = []
    for cells in csv.DictReader(results.read_text().splitlines()):
        name = next((n for n in names if cells["name"] == n or cells["name"].startswith(f"{n}, ")), None)
        if name is None:
            continue
        # What follows the name of other rows says how large the work is.
        precision = "f32" if name in splats else cells["name"][len(name) + 2 :] or "f32"
        times = [float(cells[c]) for c in ["best_ms", "ms", "best_core_ms", "core_ms"]]
        flops = None if name in splats else float(cells["rate"]) * 1e6 * times[1]
        rows.append(table.line(name, (peer, precision, int(cells["samples"])), times, flops))
    missing = set(names) - {r["work"] for r in rows}
    if missing:
        raise RuntimeError(f"{results} has no row for {sorted(missing)}")
    return rows


class Driver:
    """A Vulkan driver that `./x peers` prepared, or what is installed."""

    def __init__(self, told=None, base=True):
        self.on = "" if base else f" on {told['name']}"
        own = told["environment"] if told else {}
        # The kernels are those that guard4d chooses.
        self.environment = {k: v for k, v in os.environ.items() if k != "GUARD4D_KERNELS"} | own
        self.runner = shlex.split(own.get(RUNNER, ""))

    def guard4d(self, benches, folder):
        """guard4d's rows, and what the Vulkan device is; writes the scenes into the folder, too."""
        program = [*self.runner, benches, "--bench"] if benches else [ROOT / "x", "bench"]
        command = [*program, *filters(), "--out", folder, "--scenes", folder]
        subprocess.run(command, env=self.environment, check=True)
        return guard4d_rows(folder / "results.csv", f"guard4d{self.on}"), device_of(folder)

    def gausscam(self, folder, device):
        """gausscam's rows, and why there are none."""
        why = absent("gausscam", "wgpu", "metal_gauss")
        if why:
            return [], why
        command = [*self.runner, sys.executable, HERE / "gausscam_rows.py", folder, device, f"gausscam{self.on}"]
        done = subprocess.run(command, env=self.environment, stdout=subprocess.PIPE, check=True)
        out = json.loads(done.stdout)
        return out["rows"], out["missing"]


def prepared(value):
    """A driver with its environment, as `./x peers` hands it on."""
    try:
        return json.loads(value)
    except json.JSONDecodeError as error:
        why = "`./x peers` prepares drivers; --driver stands in front of the other arguments"
        raise argparse.ArgumentTypeError(why) from error


def measured(drivers, benches, folder):
    """All rows, remarks on them, and what the Vulkan devices are."""
    rows, remarks, devices = [], [], []
    rows += networks.torch_rows("cpu", [("f32", torch.float32), ("bf16", torch.bfloat16)])
    if torch.cuda.is_available():
        precisions = [("f32", torch.float32), ("f16", torch.float16), ("bf16", torch.bfloat16)]
        rows += networks.torch_rows("cuda", precisions)

    def told(name, why):
        if why:
            remarks.append(f"{name}: not measured, because {why}")
            print(remarks[-1], file=sys.stderr)

    # guard4d between the peers, so that a drift of the machine does not favour one of them alone.
    for driver, peer in itertools.zip_longest(drivers, PEERS):
        if driver:
            own, device = driver.guard4d(benches, folder)
            devices.append(f"Vulkan device of guard4d{driver.on}: {'; '.join(device)}")
            frames, why = driver.gausscam(folder, device[0])
            told(f"gausscam{driver.on}", why)
            rows += own + frames
        if peer:
            name, missing, measure = peer
            why = missing()
            told(name, why)
            rows += [] if why else measure(folder)
    return rows, remarks, devices


NOTES = """\
Best and median of the samples; CPU time is that of all threads of the process, a software driver's among them. The
last two columns are guard4d's f32 speed as a share of the row's, from the best times: 50 means that guard4d takes twice
as long. Of several drivers the first is the one that shares are taken of; work that guard4d does not do has none.

- **torch CUDA** is there where an NVIDIA device is; guard4d's rows are of the Vulkan device that `./x bench` takes, and
  **ncnn**'s of what is installed.
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
- ncnn's "its default, 16-bit" is what it does unless told otherwise: storage and arithmetic in 16-bit floats where the
  device says that it has them.

## Splats

Each peer draws the file that guard4d's benchmark wrote of its scene, and its picture is compared with guard4d's.
`splat/forward` is a picture from splats alone, by the clock on the wall for all, with all that the host waits for and
allocates; `splat/rasterize forward` blends lists that are there, and `splat/rasterize backward` takes the gradient of
the pixels back to the colours. guard4d's embedding makes lists once and blends them in every step.

- **metal-gauss** is its reference in PyTorch on the processor, tile by tile in whole tensors, as fast as we found it
  to be (tiles of 8x8). It makes its lists in the call that blends, a tenth of that time. Autograd has kept the weights
  for the way back, where guard4d computes them anew.
- **gausscam** draws through wgpu on the Vulkan driver of the guard4d rows above it. It is handed colours, where guard4d
  evaluates spherical harmonics; it cuts pixels off to 8 bits, draws depth besides, and its time has the way from the
  device in it. It cannot go backward.
- **gsplat** is there where CUDA is; its blending is timed by the device's clock.

Renderers that do not run here:

- taichi-splatting 0.13.0 wants taichi-nightly, which PyPI does not have for this Python, and compiles CUDA when it is
  imported. With taichi 1.7.4, and PyTorch in the place of that CUDA, its kernels do not compile: for the processor
  "ti.block.shared_array is not supported for arch Arch.x64", for Vulkan "Type [Tensor (6) f32] not supported".
- gsplat 1.5.3's own reference in PyTorch takes its pairs of pixels and splats from a CUDA kernel ("'NoneType' object
  has no attribute 'rasterize_to_indices_3dgs'"), and its sums from nerfacc 0.5.3 ("Only support cuda inputs").
- splax 0.2.3 with jax 0.10.2 and warp-lang 1.19.0 on the processor: "JaxCallableGraphMode.WARP is not supported for JAX
  CPU FFI calls".
- gswarp 1.1.0: "means3D must be a CUDA tensor".

## Image marks

A mark of images is paid for in every frame of every film. guard4d's is paid for once per scene and then in no frame,
and it is read from a clip (`guard4d verify`), so that there is no row of guard4d to set beside these.

- **invisible-watermark** brings RivaGAN's weights. The frame is a picture of tests/golden at 400x400, chosen among a
  dozen because all three find the 32 bits again in it; in most of the others one of them did not. These rows say what a
  mark costs, and nothing about how well it is read.
- TrustMark 0.9.2 and VideoSeal 1.0.1 bring no weights in their packages and fetch them elsewhere: not measured.
"""


def versions():
    """The packages that are installed."""
    for package in PACKAGES:
        try:
            yield f"{package} {importlib.metadata.version(package)}"
        except importlib.metadata.PackageNotFoundError:
            yield f"no {package}"


def markdown(rows, remarks, devices, args):
    """The page that people read."""
    command = ["./x", "peers", *(part for driver in args.driver for part in ["--driver", driver["name"]])]
    out = [
        "# Peers beside guard4d, one run on one machine\n",
        f"- Processor: {processor()}; load before the run: {args.load}",
        f"- Versions: {', '.join(versions())}, Python {platform.python_version()}; {torch.get_num_threads()} threads",
        *(f"- {device}" for device in devices),
        f"- Commit: {args.commit}; command: `{shlex.join(command)}`, which runs `./x bench {shlex.join(filters())}`",
        f"- Date: {datetime.datetime.now(datetime.UTC):%F}",
        *(f"- {remark}" for remark in remarks),
    ]
    return "\n".join([*out, "", NOTES, table.markdown(rows)]) + "\n"


def processor():
    lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.split(": ")[1] for line in lines if line.startswith("model name")), platform.machine())
    flags = next((line.split() for line in lines if line.startswith("flags")), [])
    vectors = [flag for flag in ["avx2", "fma", "avx512f", "avx512_bf16", "amx_bf16"] if flag in flags]
    return f"{model}, {os.cpu_count()} threads; of vector extensions it has {', '.join(vectors) or 'none of note'}"


def device_of(folder):
    """The Vulkan device, its driver and its kernels, as the benchmark's own summary names them."""
    lines = (folder / "summary.md").read_text().splitlines()
    about = next(line for line in lines if line.startswith("- Device: ")).removeprefix("- Device: ")
    return about.split("; ")[:3]


def results(device):
    """Where today's results on a device go: the folder that `./x bench` takes, too."""
    slug = "-".join(re.findall("[a-z0-9]+", device.lower()))
    return ROOT / "benches/results" / f"{datetime.datetime.now(datetime.UTC):%F}-{slug}"


def arguments():
    """The command line, and what is said of the run."""
    parser = argparse.ArgumentParser(prog="./x peers", description=__doc__)
    about = "Vulkan driver of guard4d's rows, as in `./x conformance`; stands in front of the other arguments and may "
    about += "be repeated: all are measured, and shares are of the first [default: what is installed]"
    parser.add_argument("--driver", type=prepared, action="append", default=[], help=about)
    parser.add_argument("--out", type=pathlib.Path, help="folder for the tables [default: benches/results/DATE-DEVICE]")
    parser.add_argument("--benches", type=pathlib.Path, help="guard4d's benchmarks as `./x gpu --build` packed them")
    args = parser.parse_args()
    args.load = " ".join(f"{v:.2f}" for v in os.getloadavg()[:2])
    head = ["git", "-C", ROOT, "rev-parse", "HEAD"]
    args.commit = subprocess.run(head, capture_output=True, text=True, check=True).stdout.strip()
    return args


def main():
    args = arguments()
    torch.manual_seed(0)
    drivers = [Driver(told, base=n == 0) for n, told in enumerate(args.driver or [None])]
    with tempfile.TemporaryDirectory() as folder:
        rows, remarks, devices = measured(drivers, args.benches, pathlib.Path(folder))
        device = device_of(pathlib.Path(folder))[0]
    rows = table.compare(rows)
    remarks += splat_verdicts(rows)
    print("\n".join(remarks))
    out = args.out or results(device)
    out.mkdir(parents=True, exist_ok=True)
    table.write(rows, out / "peers.csv")
    (out / "peers.md").write_text(markdown(rows, remarks, devices, args))
    print(out / "peers.md")


if __name__ == "__main__":
    main()
