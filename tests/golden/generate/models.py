"""Golden of the model folders: what each network makes of its splats, in f64; see "models" in ../README.md."""

import ast
import re

import torch
import torch.nn.functional as F
from common import FOLDER, save

PLANES = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


def columns(path):
    """Values of a PLY by name, f64; `name` or `name_0`, `name_1`, ..."""
    head, body = re.split(rb"(?<=end_header\n)", path.read_bytes(), maxsplit=1)
    names = re.findall(r"property float (\S+)", head.decode())
    rows = torch.frombuffer(bytearray(body), dtype=torch.float32).reshape(-1, len(names)).double()
    return lambda name: rows[:, [i for i, n in enumerate(names) if re.fullmatch(rf"{name}(_\d+)?", n)]]


def features(net, xyz, time):
    """Per level the product of six bilinear reads at (x, y, z, t): the box as it is stored, the time as it is."""
    first, last = net["grid.aabb"]
    at = torch.cat([(xyz - first) * 2 / (last - first) - 1, torch.full_like(xyz[:, :1], time)], 1)[None, None]
    count = len({key.split(".")[2] for key in net if key.startswith("grid.grids.")})
    read = lambda plane, pair: F.grid_sample(plane, at[..., pair], "bilinear", "border", align_corners=True)[0, :, 0].T
    level = lambda i: torch.stack([read(net[f"grid.grids.{i}.{j}"], pair) for j, pair in enumerate(PLANES)]).prod(0)
    return torch.cat([level(i) for i in range(count)], 1)


def hamilton(a, b):
    (w, x, y, z), (p, q, r, s) = a.T, b.T
    parts = [w * p - x * q - y * r - z * s, w * q + x * p + y * s - z * r]
    return torch.stack([*parts, w * r - x * s + y * p + z * q, w * s + x * r - y * q + z * p], 1)


def moment(net, flags, splat, time):
    """All tensors at one time, before activation."""
    linear = lambda name, x: F.linear(x, net[f"{name}.weight"], net[f"{name}.bias"])
    head = lambda name: linear(f"{name}_deform.3", linear(f"{name}_deform.1", hidden.relu()).relu())
    moved = lambda x, flag, name: x if flags[flag] else x + head(name).reshape(x.shape)
    xyz = torch.cat([splat("x"), splat("y"), splat("z")], 1)
    feat = hidden = features(net, xyz, time)
    for layer in sorted(key.removesuffix(".weight") for key in net if re.match(r"feature_out.*weight", key)):
        hidden = linear(layer, hidden if hidden is feat else hidden.relu())
    rot = moved(splat("rot"), "no_dr", "rotations")
    if flags["apply_rotation"] and not flags["no_dr"]:
        rot = F.normalize(hamilton(splat("rot"), head("rotations")))
    sh = torch.cat([splat("f_dc")[:, None], splat("f_rest").reshape(-1, 3, 15).transpose(1, 2)], 1)
    moving = {"xyz": moved(xyz, "no_dx", "pos"), "scale": moved(splat("scale"), "no_ds", "scales"), "rot": rot}
    colours = {"opacity": moved(splat("opacity"), "no_do", "opacity"), "sh": moved(sh, "no_dshs", "shs")}
    return {"feat": feat, "hidden": hidden, **moving, **colours}


for folder in sorted((FOLDER / "models").iterdir()):
    splat, state = next(folder.glob("*/*/point_cloud.ply")), next(folder.glob("*/*/deformation.pth"))
    state = torch.load(state, map_location="cpu", weights_only=True)
    net = {key.removeprefix("deformation_net."): value.double() for key, value in state.items()}
    settings = ast.parse((folder / "cfg_args").read_text(), mode="eval").body.keywords
    flags = {setting.arg: ast.literal_eval(setting.value) for setting in settings}
    times = {f"t{time}.": moment(net, flags, columns(splat), time) for time in [0.0, 0.37, 0.5, 1.0]}
    save(f"models/{folder.name}/expected", {key + name: t for key, part in times.items() for name, t in part.items()})
