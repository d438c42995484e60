"""Makes engine/assets/demo-scene from a larger 4DGaussians model folder.

    python3 engine/assets/generate/demo_scene.py --model ROBOT_FOLDER --out engine/assets/demo-scene

1. Splats: farthest-point sampling over place at four times, normal and colour keeps `--splats` of them; each keeps
   its own position and rotation, takes the mean SH of the splats nearest to it, and grows to cover their cell.
2. Deformation: the box of the planes shrinks to the scene and their spatial resolution to a half; planes and the
   position, scale and rotation heads are trained to give what the original gives for the kept splats at any time.

Needs numpy and PyTorch; written with torch 2.15 on one thread, for which the result repeats byte for byte.
Prints the error of the motion against the original, over times that training does not favour.
"""

import argparse
import ast
import json
import shutil
from collections import OrderedDict
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

ITERATION = "point_cloud/iteration_20000"
PAIRS = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
HEADS = {"pos_deform": slice(0, 3), "scales_deform": slice(3, 6), "rotations_deform": slice(6, 10)}
SH_DC = 0.28209479177387814
# Columns of a 62-property PLY.
XYZ, SH, OPACITY, SCALE, ROT = slice(0, 3), slice(6, 54), 54, slice(55, 58), slice(58, 62)


def read_ply(path):
    raw = path.read_bytes()
    end = raw.index(b"end_header\n") + len(b"end_header\n")
    header = raw[:end].decode()
    return header, np.frombuffer(raw[end:], "<f4").reshape(-1, 62).copy()


def deform(state, points, times):
    """Raw offsets [N,10] (position, log scale, quaternion) of `points` [N,3] at `times` [N]; differentiable."""
    aabb = state["deformation_net.grid.aabb"]
    q = torch.cat([(points - aabb[0]) * 2 / (aabb[1] - aabb[0]) - 1, times[:, None]], 1)
    levels, level = [], 0
    while f"deformation_net.grid.grids.{level}.0" in state:
        feature = 1.0
        for k, pair in enumerate(PAIRS):
            plane = state[f"deformation_net.grid.grids.{level}.{k}"]
            at = q[None, None][..., list(pair)]
            taps = F.grid_sample(plane, at, mode="bilinear", padding_mode="border", align_corners=True)
            feature = feature * taps[0, :, 0].T
        levels.append(feature)
        level += 1

    def linear(name, x):
        return F.linear(x, state[f"deformation_net.{name}.weight"], state[f"deformation_net.{name}.bias"])

    hidden = F.relu(linear("feature_out.0", torch.cat(levels, 1)))
    return torch.cat([linear(f"{h}.3", F.relu(linear(f"{h}.1", hidden))) for h in HEADS], 1)


@torch.no_grad()
def offsets_at(state, points, time):
    return deform(state, points, torch.full((len(points),), float(time))).numpy()


def axes(quats):
    """Columns of the rotation matrices of `quats` [N,4] wxyz, as [N,3,3]."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def sample(features, count, rng):
    """Farthest-point sampling: indices kept [count] and, for every point, which of them is nearest."""
    first = int(rng.integers(len(features)))
    kept, nearest = [first], np.zeros(len(features), np.int64)
    distance = ((features - features[first]) ** 2).sum(1)
    for i in range(1, count):
        new = int(distance.argmax())
        kept.append(new)
        to_new = ((features - features[new]) ** 2).sum(1)
        closer = to_new < distance
        nearest[closer] = i
        distance[closer] = to_new[closer]
    return np.array(kept), nearest


def even_out(features, kept, nearest, rounds):
    """Lloyd's rounds with members for centres: every splat kept moves to the member closest to its cell's mean."""
    square = (features**2).sum(1)
    for _ in range(rounds):
        centres = cell_means(features, nearest, len(kept))
        off = ((features - centres[nearest]) ** 2).sum(1)
        order = np.lexsort((off, nearest))
        kept = order[np.searchsorted(nearest[order], np.arange(len(kept)))]
        for rows in np.array_split(np.arange(len(features)), 32):
            distance = square[kept] - 2 * features[rows] @ features[kept].T
            nearest[rows] = distance.argmin(1)
        nearest[kept] = np.arange(len(kept))
    return kept, nearest


def cell_means(values, nearest, count):
    total = np.zeros((count, values.shape[1]))
    np.add.at(total, nearest, values)
    return total / np.bincount(nearest, minlength=count)[:, None]


def thin_out(splats, state, args):
    """The kept splats: own position, rotation and opacity; mean SH; scales that cover their cell."""
    points = torch.from_numpy(splats[:, XYZ].copy())
    moved = [splats[:, XYZ] + offsets_at(state, points, t)[:, :3] for t in (0.0, 0.35, 0.7, 1.0)]
    frames = axes(splats[:, ROT])
    thin = splats[:, SCALE].argmin(1)
    normals = np.take_along_axis(frames, thin[:, None, None], 2)[:, :, 0]
    sigma = np.exp(np.sort(splats[:, SCALE], 1)[:, 1:]).mean()
    cell = 2 * sigma * np.sqrt(len(splats) / args.splats)
    colour = 0.5 + SH_DC * splats[:, 6:9]
    place = np.concatenate(moved, 1) / 2
    features = np.concatenate([place, args.normal * cell * normals, args.colour * cell * colour], 1).astype(np.float32)
    kept, nearest = sample(features, args.splats, np.random.default_rng(args.seed))
    kept, nearest = even_out(features, kept, nearest, args.rounds)

    # Variance of the cell along each axis of its splat: spread of the members, plus their own extent.
    local = np.einsum("nik,ni->nk", frames[kept][nearest], splats[:, XYZ] - splats[kept][nearest][:, XYZ])
    variance = cell_means(local**2 + np.exp(2 * splats[:, SCALE]), nearest, args.splats)
    out = splats[kept].copy()
    out[:, SH] = cell_means(splats[:, SH], nearest, args.splats)
    flat = thin[kept]
    scales = np.log(np.sqrt(variance) * args.grow)
    rows = np.arange(args.splats)
    scales[rows, flat] = splats[kept, SCALE.start + flat]
    out[:, SCALE] = scales
    out[:, OPACITY] += args.firm
    return out


def shrink(state, splats):
    """A copy whose box hugs the scene and whose spatial axes have half the samples; the time axis stays."""
    key = "deformation_net.grid.aabb"
    place = torch.from_numpy(splats[:, XYZ])
    high, low = place.amax(0), place.amin(0)
    margin = 0.02 * (high - low)
    old, new = state[key], torch.stack([high + margin, low - margin])

    def nodes(axis, count):
        unit = torch.linspace(-1, 1, count)
        if axis == 3:
            return unit
        world = (unit + 1) / 2 * (new[1] - new[0])[axis] + new[0, axis]
        return (world - old[0, axis]) * 2 / (old[1] - old[0])[axis] - 1

    small = OrderedDict((k, v.clone()) for k, v in state.items())
    small._metadata = state._metadata
    small[key] = new
    for k in (k for k in state if ".grids." in k):
        a, b = PAIRS[int(k.rsplit(".", 1)[1])]
        height, width = state[k].shape[2:]
        rows, columns = nodes(b, height if b == 3 else height // 2), nodes(a, width // 2)
        at = torch.stack(torch.broadcast_tensors(columns[None, :], rows[:, None]), 2)
        small[k] = F.grid_sample(state[k], at[None], mode="bilinear", padding_mode="border", align_corners=True)
    return small


def fit(small, state, splats, args):
    """Trains the small field against the original on the kept splats; errors are weighed as lengths."""
    points = torch.from_numpy(splats[:, XYZ].copy())
    extent = float(np.exp(splats[:, SCALE]).max(1).mean())
    weights = torch.tensor([1.0] * 3 + [extent] * 3 + [2 * extent] * 4)
    used = [k for k in small if ".grids." in k or "feature_out" in k or any(h in k for h in HEADS)]
    for key in used:
        small[key].requires_grad_(True)
    groups = [
        {"params": [small[k] for k in used if ".grids." in k], "lr": args.lr},
        {"params": [small[k] for k in used if ".grids." not in k], "lr": args.lr / 5},
    ]
    adam = torch.optim.Adam(groups, eps=1e-15)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(adam, args.steps)
    generator = torch.Generator().manual_seed(args.seed)
    for step in range(args.steps):
        pick = torch.randperm(len(points), generator=generator)[: args.batch]
        times = torch.rand(len(pick), generator=generator)
        # The ends of the range are where a video starts and stops; random times seldom touch them.
        times = (times * 1.1 - 0.05).clamp(0, 1)
        with torch.no_grad():
            want = deform(state, points[pick], times)
        loss = (((deform(small, points[pick], times) - want) * weights) ** 2).sum(1).mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        decay.step()
        if step % 200 == 0 or step + 1 == args.steps:
            print(f"step {step}: rms {loss.item() ** 0.5:.5f}", flush=True)
    for key in used:
        small[key].requires_grad_(False)
    return small


def report(small, state, splats):
    points = torch.from_numpy(splats[:, XYZ].copy())
    moved, place, angle = [], [], []
    for time in np.linspace(0, 1, 25):
        want, got = offsets_at(state, points, time), offsets_at(small, points, time)
        place.append(np.linalg.norm(got[:, :3] - want[:, :3], axis=1))
        moved.append(np.linalg.norm(want[:, :3], axis=1))
        a, b = splats[:, ROT] + got[:, 6:], splats[:, ROT] + want[:, 6:]
        cos = np.abs((a * b).sum(1)) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        angle.append(2 * np.degrees(np.arccos(np.clip(cos, 0, 1))))
    place, angle = np.array(place), np.array(angle)
    radius = np.linalg.norm(splats[:, XYZ] - splats[:, XYZ].mean(0), axis=1).max()
    print(
        f"{len(splats)} splats, radius {radius:.3f}, motion mean {np.mean(moved):.4f} max {np.max(moved):.4f}; "
        f"position error mean {place.mean():.5f} p99 {np.percentile(place, 99):.5f} max {place.max():.5f}; "
        f"rotation error mean {angle.mean():.2f} p99 {np.percentile(angle, 99):.2f} degrees"
    )


def config_text(model, out_name):
    """The original's cfg_args with the smaller resolution; parsed, never evaluated."""
    call = ast.parse((model / "cfg_args").read_text().strip(), mode="eval").body
    flags = {k.arg: ast.literal_eval(k.value) for k in call.keywords}
    space = flags["kplanes_config"]["resolution"]
    flags["kplanes_config"]["resolution"] = [r // 2 for r in space[:3]] + space[3:]
    flags["model_path"] = f"./output/dnerf/{out_name}"
    return "Namespace(" + ", ".join(f"{k}={v!r}" for k, v in sorted(flags.items())) + ")"


def write(out, header, splats, small, model):
    folder = out / ITERATION
    if out.exists():
        shutil.rmtree(out)
    folder.mkdir(parents=True)
    count = f"element vertex {len(splats)}"
    lines = [count if line.startswith("element vertex") else line for line in header.split("\n")]
    (folder / "point_cloud.ply").write_bytes("\n".join(lines).encode() + splats.astype("<f4").tobytes())
    torch.save(small, folder / "deformation.pth")
    torch.save(torch.ones(len(splats), dtype=torch.bool), folder / "deformation_table.pth")
    torch.save(torch.zeros(len(splats), 3), folder / "deformation_accum.pth")
    (out / "cfg_args").write_text(config_text(model, out.name))
    views = json.loads((model / "transforms_test.json").read_text())
    (out / "transforms_test.json").write_text(json.dumps(views, separators=(",", ":")) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--splats", type=int, default=11_000)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--steps", type=int, default=2500)
    parser.add_argument("--batch", type=int, default=4096)
    parser.add_argument("--lr", type=float, default=0.01)
    parser.add_argument("--rounds", type=int, default=4, help="rounds that even out the cells")
    parser.add_argument("--grow", type=float, default=1.2, help="factor on the scales that cover a cell")
    parser.add_argument("--firm", type=float, default=1.0, help="added to opacity logits, as fewer splats overlap")
    parser.add_argument("--normal", type=float, default=0.35, help="cells that a turn by one radian is worth")
    parser.add_argument("--colour", type=float, default=2.0, help="cells that a full step of one colour is worth")
    args = parser.parse_args()
    torch.set_num_threads(1)
    header, splats = read_ply(args.model / ITERATION / "point_cloud.ply")
    state = torch.load(args.model / ITERATION / "deformation.pth", weights_only=True)
    kept = thin_out(splats, state, args)
    small = shrink(state, kept)
    report(small, state, kept)
    small = fit(small, state, kept, args)
    report(small, state, kept)
    write(args.out, header, kept, small, args.model)


if __name__ == "__main__":
    main()
