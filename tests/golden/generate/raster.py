"""Writes tests/golden/raster.safetensors: a random scene by the rules of 3D Gaussian splatting, pair by pair in float64.

Every splat is tried on every pixel; there are no lists, no sort by keys and no early exit as on a device. The rules are
those of Kerbl et al. 2023 as their renderer has them: depth above 0.2, blur 0.3, tiles of 16 px, alpha between 1/255
and 0.99, and a pixel ends before its transmittance falls below 1e-4.

Splats that come within MARGIN of a decision are left out, so that float32 decides everywhere as float64 does.
"""

import math

import torch
from common import save

WIDTH, HEIGHT, TILE = 61, 45, 16
FOCAL = 52.0
BACKGROUND = (0.2, 0.5, 0.9)
NEAR_DEPTH, BLUR, FRUSTUM_MARGIN, MIN_SPREAD = 0.2, 0.3, 1.3, 0.1
MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE = 1 / 255, 0.99, 1e-4
# Relative distance from a decision; float32 moves the compared numbers by 1e-5 at most.
MARGIN = 1e-3


def scene(generator):
    """Means, log scales, quaternions, opacity logits and SH coefficients of candidates, some of them awkward."""

    def rand(*shape, low=-1.0, high=1.0):
        return low + (high - low) * torch.rand(shape, generator=generator)

    count = 420
    means = rand(count, 3) * torch.tensor([1.3, 1.0, 1.2])
    log_scales = rand(count, 3, low=-4.5, high=-1.8)
    quats = rand(count, 4) * rand(count, 1, low=0.1, high=4.0)
    logits = rand(count, low=-3.0, high=3.0)
    sh = rand(count, 16, 3) * 0.25
    sh[:, 0] = rand(count, 3) * 1.8
    log_scales[:40] = torch.tensor([-2.6, -9.0, -9.5])  # needles
    log_scales[40:80] = rand(40, 3, low=-1.5, high=-0.9)  # large and opaque: pixels that end early
    logits[40:80] = 6.0
    logits[80:90] = -6.0  # below 1/255
    means[90:110] = rand(20, 3) * 0.4 + torch.tensor([0.0, 0.0, -3.0])  # around the camera
    means[110:130] *= 4.0  # beside the picture
    means[130:150] = means[150:170]  # the same depth: the lower index comes first
    return means, log_scales, quats, logits, sh


def camera():
    """World to camera, OpenCV axes: a little above the scene, looking at its middle."""
    eye = torch.tensor([0.5, -0.7, -2.8], dtype=torch.float64)
    forward = -eye / eye.norm()
    right = torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64), forward)
    right = right / right.norm()
    turn = torch.stack([right, torch.linalg.cross(forward, right), forward])
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ eye
    return matrix.float().double()  # as the file holds it


def rotations(quats):
    """Matrices of quaternions w, x, y, z of any length."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return torch.stack([torch.stack(row, 1) for row in rows], 1)


def bases(directions):
    """Real spherical harmonics up to degree 3 with the Condon-Shortley phase, `[N,16]`."""
    x, y, z = directions.unbind(1)
    over = [math.sqrt(k / math.pi) for k in (1 / 4, 3 / 4, 15 / 4, 5 / 16, 15 / 16, 35 / 32, 105 / 4, 21 / 32, 7 / 16, 105 / 16)]
    y0, y1, y2, y20, y22, y33, y32, y31, y30, y32c = over
    return torch.stack(
        [
            torch.full_like(x, y0),
            -y1 * y, y1 * z, -y1 * x,
            y2 * x * y, -y2 * y * z, y20 * (3 * z * z - 1), -y2 * x * z, y22 * (x * x - y * y),
            -y33 * y * (3 * x * x - y * y), y32 * x * y * z, -y31 * y * (5 * z * z - 1), y30 * z * (5 * z * z - 3),
            -y31 * x * (5 * z * z - 1), y32c * z * (x * x - y * y), -y33 * x * (x * x - 3 * y * y),
        ],
        1,
    )  # fmt: skip


def far(value, bound):
    """Whether `value` is farther from `bound` than float32 could move it."""
    return (value - bound).abs() > MARGIN * bound


def project(view, means, log_scales, quats):
    """Pixel, conic, depth, rectangle of tiles, and whether all decisions are clear."""
    p = means @ view[:3, :3].T + view[:3, 3]
    depth = p[:, 2]
    size = torch.tensor([WIDTH, HEIGHT], dtype=p.dtype)
    limit = FRUSTUM_MARGIN * size / (2 * FOCAL)
    slope = p[:, :2] / depth[:, None]
    inside = slope.clamp(-limit, limit)
    jacobian = torch.zeros(len(p), 2, 3, dtype=p.dtype)
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = FOCAL / depth
    jacobian[:, :, 2] = -FOCAL * inside / depth[:, None]
    spread = jacobian @ view[:3, :3] @ rotations(quats) @ torch.diag_embed(log_scales.exp())
    covariance = spread @ spread.transpose(1, 2) + BLUR * torch.eye(2, dtype=p.dtype)
    conic = covariance.inverse()
    middle = covariance.diagonal(dim1=1, dim2=2).mean(1)
    room = middle**2 - covariance.det()
    exact = 3 * (middle + room.clamp(min=MIN_SPREAD).sqrt()).sqrt()
    radius = exact.ceil()[:, None]
    pixel = slope * FOCAL + (size - 1) / 2
    low, high = (pixel - radius) / TILE, (pixel + radius + TILE - 1) / TILE
    tiles = (size / TILE).ceil()
    clear = far(depth, NEAR_DEPTH) & ((exact - exact.round()).abs() > MARGIN)
    clear &= ((low - low.round()).abs() > MARGIN).all(1) & ((high - high.round()).abs() > MARGIN).all(1)
    # Rounding towards zero or down is one after the clamp.
    low, high = low.floor().clamp(min=0).minimum(tiles), high.floor().clamp(min=0).minimum(tiles)
    return pixel, conic, depth, (low, high), clear | (depth < NEAR_DEPTH * (1 - MARGIN))


def weigh(pixel, conic, depth, rectangle, opacity):
    """Blending weights `[pixels,N]`, transmittance, share of pixels that end early, and splats near no decision."""
    rows, columns = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    places = torch.stack([columns.flatten(), rows.flatten()], 1).to(pixel.dtype)
    tile = (places / TILE).floor()
    transmittance = torch.ones(len(places), dtype=pixel.dtype)
    alive = torch.ones(len(places), dtype=torch.bool)
    weights = torch.zeros(len(places), len(pixel), dtype=pixel.dtype)
    clear = torch.ones(len(pixel), dtype=torch.bool)
    for i in torch.sort(depth.float(), stable=True).indices.tolist():
        if depth[i] <= NEAR_DEPTH or opacity[i] < MIN_ALPHA:
            continue
        seen = alive & (tile >= rectangle[0][i]).all(1) & (tile < rectangle[1][i]).all(1)
        d = pixel[i] - places
        power = -0.5 * torch.einsum("pi,ij,pj->p", d, conic[i], d)
        alpha = (opacity[i] * power.exp()).clamp(max=MAX_ALPHA)
        clear[i] &= bool(far(alpha, MIN_ALPHA)[seen].all())
        seen &= alpha >= MIN_ALPHA
        after = transmittance * (1 - alpha)
        clear[i] &= bool(far(after, MIN_TRANSMITTANCE)[seen].all())
        alive &= ~(seen & (after < MIN_TRANSMITTANCE))
        seen &= alive
        weights[seen, i] = (alpha * transmittance)[seen]
        transmittance = torch.where(seen, after, transmittance)
    return weights, transmittance, 1 - alive.double().mean().item(), clear


def main():
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    view, candidates = camera(), scene(generator)
    eye = -view[:3, :3].T @ view[:3, 3]
    kept = torch.ones(len(candidates[0]), dtype=torch.bool)
    while True:
        stored = [part[kept] for part in candidates]
        means, log_scales, quats, logits, sh = (part.double() for part in stored)
        pixel, conic, depth, rectangle, clear = project(view, means, log_scales, quats)
        gaps = depth.sort().values.diff()
        assert ((gaps == 0) | (gaps > 1e-6)).all(), "float32 orders as float64"
        directions = means - eye
        basis = bases(directions / directions.norm(dim=1, keepdim=True))
        raw = 0.5 + torch.einsum("nb,nbc->nc", basis, sh)
        # Float32 moves a colour by 1e-6, whatever its size.
        clear &= (raw.abs() > MARGIN).all(1)
        weights, transmittance, ended, clear_pairs = weigh(pixel, conic, depth, rectangle, logits.sigmoid())
        clear &= clear_pairs
        if clear.all():
            break
        kept[kept.nonzero().flatten()[~clear]] = False
    seen, black = int((weights.sum(0) > 0).sum()), (raw < 0).double().mean().item()
    print(f"{len(means)} splats, {seen} of them seen, {ended:.1%} of pixels end early, {black:.1%} of colours cut at 0")
    assert seen > 200 and ended > 0.05 and black > 0.05 and (depth < NEAR_DEPTH).any(), "every rule must matter"
    sh.requires_grad_()
    colours = (0.5 + torch.einsum("nb,nbc->nc", basis, sh)).clamp(min=0)
    image = weights @ colours + transmittance[:, None] * torch.tensor(BACKGROUND, dtype=torch.float64)
    image = image.reshape(HEIGHT, WIDTH, 3)
    v_image = torch.rand(image.shape, generator=generator) * 2 - 1
    (image * v_image.double()).sum().backward()
    names = ("means", "scales", "quats", "opacities", "sh")
    tensors = dict(zip(names, stored, strict=True))
    tensors |= {"world_to_camera": view, "focal": torch.tensor([FOCAL]), "background": torch.tensor(BACKGROUND)}
    tensors |= {"image": image, "final_T": transmittance.reshape(HEIGHT, WIDTH), "weight_sum": weights.sum(0)}
    tensors |= {"dL_dimage": v_image, "dL_dsh": sh.grad}
    save("raster", tensors)


if __name__ == "__main__":
    main()
