"""gausscam's rows, in a process of their own so that each Vulkan driver can be loaded: peers.py runs this file.

Takes the folder of the scenes, the name of the Vulkan device and that of the peer. Prints JSON: the rows, or why there
are none.
"""

import json
import math
import pathlib
import sys

import numpy as np
import torch
import wgpu
from gausscam.backends.webgpu import Pipeline, pick_variant
from metal_gauss.sh import eval_sh
from torch.nn import functional

from splats import check_picture, gsplat_arguments, scenes, splat_names
from table import row

# Storage buffers that its one bind group holds.
BUFFERS = 35
# Room for pairs of a tile and a splat; more of it was slower. Its tiles of 16x16 pixels hold 150 thousand.
PAIRS = 1 << 18
# The first basis function of spherical harmonics, the only one that it evaluates.
SH_0 = 0.28209479177387814


def missing(device):
    """Why this device cannot run it, or `None`."""
    adapters = wgpu.gpu.enumerate_adapters_sync()
    found = [a for a in adapters if a.info["backend_type"] == "Vulkan" and device in a.info["device"]]
    if not found:
        return f"wgpu finds no Vulkan device {device}"
    limit = found[0].limits["max-storage-buffers-per-shader-stage"]
    return None if limit >= BUFFERS else f"it binds {BUFFERS} storage buffers, and the driver allows {limit}"


def arguments(scene):
    """A scene as gausscam takes it: the colours of this one camera, which looks along -z."""
    given = gsplat_arguments(scene)
    turn, shift = scene["viewmat"][:3, :3], scene["viewmat"][:3, 3]
    eye = -turn.T @ shift
    directions = functional.normalize(scene["means"] - eye, dim=1)
    colours = (eval_sh(given["sh_degree"], scene["sh_coeffs"], directions) + 0.5).clamp_min(0)
    tensors = {"xyz": scene["means"], "rot": functional.normalize(scene["quats"], dim=1), "scale": given["scales"]}
    tensors |= {"opacity": given["opacities"], "sh": (colours - 0.5) / SH_0, "cam_pos": eye[None]}
    tensors |= {"cam_xmat": (turn.T * torch.tensor([1.0, -1.0, -1.0]))[None]}
    fov = 2 * math.atan(given["height"] / 2 / scene["intrinsics"][1, 1].item())
    numbers = {"W": np.int32(given["width"]), "H": np.int32(given["height"]), "fovy": np.float32(math.degrees(fov))}
    arrays = {name: np.ascontiguousarray(tensor.numpy()) for name, tensor in tensors.items()}
    return arrays | numbers | {"slots": np.zeros(0, np.int32)}


def rows(folder, device, peer):
    """Whole pictures, with their way from the device."""
    out = []
    for scene, tensors in scenes(folder):
        pipeline = Pipeline(arguments(tensors), device, variant=pick_variant(device), cap=PAIRS)
        pixels, _ = pipeline.unpack(*pipeline.render_frame())
        # It cuts colours off to 8 bits.
        want = (tensors["image"][..., :3].clamp(0, 1) * 255).floor() / 255
        check_picture(peer, scene, torch.from_numpy(pixels[0]) / 255, want)
        out.append(row(splat_names(scene)[0], peer, "f32", None, pipeline.render_frame))
    return out


def main():
    folder, device, peer = sys.argv[1:]
    why = missing(device)
    print(json.dumps({"missing": why, "rows": [] if why else rows(pathlib.Path(folder), device, peer)}))


if __name__ == "__main__":
    main()
