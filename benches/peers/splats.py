"""Splat renderers of others, on the scenes that `./x bench` writes; their pictures are compared with guard4d's."""

import importlib.util
import json
import math
import shutil
import sys

import numpy as np
import torch
from torch.utils import cpp_extension

from table import cuda_seconds, row

# Scenes of benches/kernels/splat.rs.
SCENES = ["50k, 400x400", "50k, 800x800", "30k, 800x800"]
# How many times as fast as gsplat guard4d's splats are meant to be drawn.
GSPLAT_TARGET = 2.0
# Largest mean difference of a peer's picture to guard4d's. Alpha ends at 0.999 and not at 0.99, and splats end a little
# elsewhere: 3e-5 in parts of the pictures, by gsplat's reference in PyTorch. A shift by half a pixel makes 0.03.
PICTURE_TOLERANCE = 1e-3
# Largest relative error of a gradient, against the picture, which is linear in the colours: sums of 32-bit floats.
GRADIENT_TOLERANCE = 1e-4
# How metal-gauss is fastest here: guard4d's tiles, all splats of a tile at a time, and many tiles.
METAL_GAUSS_TILES = {"tile": 8, "tile_chunk": 128}


def splat_names(scene):
    """A picture from splats alone, its last part, which blends lists of splats to pixels, and that part's way back."""
    return f"splat/forward {scene}", f"splat/rasterize forward {scene}", f"splat/rasterize backward {scene}"


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


def scenes(folder):
    """The names and tensors of the scenes in a folder."""
    for scene in SCENES:
        yield scene, read_tensors(folder / f"{scene}.safetensors")


def check_picture(peer, scene, picture, want):
    """Fails unless a peer drew what guard4d drew."""
    error = (picture.cpu() - want).abs().mean().item()
    print(f"{peer}, {scene}: mean difference to guard4d's picture {error:.1e}", file=sys.stderr)
    if not error <= PICTURE_TOLERANCE:
        raise RuntimeError(f"{peer}'s picture of {scene} is off by {error} in the mean")


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
    for scene, tensors in scenes(folder):
        given = {k: v.cuda() if isinstance(v, torch.Tensor) else v for k, v in gsplat_arguments(tensors).items()}

        def whole():
            picture = rasterization(**given)
            torch.cuda.synchronize()
            return picture

        def blend():
            return rasterize_to_pixels(meta["means2d"], meta["conics"], colors, meta["opacities"], *lists)

        with torch.inference_mode():
            picture, _, meta = whole()
            check_picture("gsplat", scene, picture[0], tensors["image"][..., :3])
            lists = [meta[name] for name in ["width", "height", "tile_size", "isect_offsets", "flatten_ids"]]
            colors = torch.rand(*meta["means2d"].shape[:-1], 3, device=picture.device)
            first, last, _ = splat_names(scene)
            rows.append(row(first, "gsplat CUDA", "f32", None, whole))
            rows.append(row(last, "gsplat CUDA", "f32", None, blend, cuda_seconds))
    return rows


def splat_verdicts(rows):
    """How guard4d's splats stand to the target, by best times: a sentence for each row of gsplat."""
    for r in rows:
        if r["peer"] == "gsplat CUDA":
            times = r["guard4d_wall_percent"] / 100
            verdict = "met" if times >= GSPLAT_TARGET else "not met"
            stands = f"guard4d is {times:.2f} times as fast as gsplat"
            yield f"{r['work']}: {stands}; at least {GSPLAT_TARGET:g} is {verdict}"


def check_gradient(peer, scene, ends):
    """Fails unless a gradient of a picture, times the colours, is what was propagated back, times the picture."""
    (v_colours, colours), (upstream, picture) = ends
    got, want = ((a.double() * b.double()).sum().item() for a, b in [(v_colours, colours), (upstream, picture)])
    if not abs(got - want) <= GRADIENT_TOLERANCE * abs(want):
        raise RuntimeError(f"{peer}'s gradient of {scene} gives {got}, its picture {want}")


def metal_gauss_rows(folder):
    """The scenes in a folder by metal-gauss's reference in PyTorch on the processor, gradients by autograd."""
    from metal_gauss import render, torch_ref

    rows = []
    for scene, tensors in scenes(folder):
        given = gsplat_arguments(tensors)
        viewmat, intrinsics, width, height = given["viewmats"][0], given["Ks"][0], given["width"], given["height"]
        shapes = [given[name] for name in ["means", "quats", "scales", "opacities", "colors"]]

        def whole():
            return render(*shapes, intrinsics, viewmat, width, height, **METAL_GAUSS_TILES)[0]

        def blend():
            splats = [uv, conics, given["opacities"], colours, depths, radii, valid]
            return torch_ref.rasterize(*splats, width, height, **METAL_GAUSS_TILES)[0]

        first, last, back = splat_names(scene)
        who = ("metal-gauss torch", "f32", None)
        with torch.inference_mode():
            check_picture("metal-gauss", scene, whole(), tensors["image"][..., :3])
            rows.append(row(first, *who, whole))
        covariances = torch_ref.build_cov3d(given["quats"], given["scales"])
        lens = [intrinsics[at].item() for at in [(0, 0), (1, 1), (0, 2), (1, 2)]]
        projected = torch_ref.project(given["means"], covariances, viewmat, *lens, width, height, 0.01, 100.0)
        uv, conics, depths, radii, valid, _ = projected
        colours = torch.rand(len(uv), 3)
        with torch.inference_mode():
            rows.append(row(last, *who, blend))
        colours.requires_grad_()
        picture, upstream = blend(), torch.rand(height, width, 3)
        backward = lambda: torch.autograd.grad(picture, colours, upstream, retain_graph=True)  # noqa: E731
        check_gradient("metal-gauss", scene, [(backward()[0], colours), (upstream, picture)])
        rows.append(row(back, *who, backward))
    return rows
