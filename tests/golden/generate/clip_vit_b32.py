"""Writes tests/golden/clip_vit_b32.safetensors: ViT-B/32-shaped CLIP towers with formula weights.

The weights are too large for the repository, so every tensor is computed from its name by `formula`; the Rust test
computes the same ones. Run in this folder:
    OMP_NUM_THREADS=1 python3 -B clip_vit_b32.py
Made with transformers 5.23 and torch 2.15 on a CPU, in float64, stored as float32.
"""

from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save_file
from transformers import CLIPConfig, CLIPModel

BATCH, SIDE = 2, 224
# Entries of the pixel gradient that are kept; 7 is coprime to the patch side, so every place in a patch occurs.
STEP, ROW, COLUMN = 7, 3, 5

# Sizes are transformers' defaults, which are ViT-B/32's, except for a small vocabulary: its table would dwarf the tower.
TEXT = {"vocab_size": 64, "bos_token_id": 62, "eos_token_id": 63, "pad_token_id": 0}
# Tokens of each text with begin and end; the rest of its 77 places is padding.
TEXT_LENGTHS, PLACES = (18, 50), 77


def formula(name, count):
    """`count` values in [-1, 1): murmur3's finaliser over index * 0x9E3779B1 + FNV-1a(name), top 24 bits."""
    seed = 0x811C9DC5
    for byte in name.encode():
        seed = ((seed ^ byte) * 0x01000193) & 0xFFFFFFFF
    x = np.arange(count, dtype=np.uint32) * np.uint32(0x9E3779B1) + np.uint32(seed)
    x ^= x >> np.uint32(16)
    x *= np.uint32(0x85EBCA6B)
    x ^= x >> np.uint32(13)
    x *= np.uint32(0xC2B2AE35)
    x ^= x >> np.uint32(16)
    return (x >> np.uint32(8)).astype(np.float64) / 2**23 - 1.0


def weight(name, shape):
    """Matrices keep the variance of their input; norms lie around 1; all other vectors and tables are small."""
    values = formula(name, int(np.prod(shape, dtype=np.int64)))
    if "norm" in name or "layrnorm" in name:
        values = 1.0 + 0.1 * values if name.endswith(".weight") else 0.1 * values
    elif len(shape) >= 2 and "position" not in name and "token" not in name:
        values = values * np.sqrt(3.0 / np.prod(shape[1:], dtype=np.int64))
    else:
        values = 0.1 * values
    return values.astype(np.float32).reshape(shape)


def images(model):
    """Features of two images, and the pixel gradient of a weighted sum of them."""
    pixels = 2.0 * formula("pixel_values", BATCH * 3 * SIDE * SIDE).reshape(BATCH, 3, SIDE, SIDE)
    pixels = torch.from_numpy(pixels.astype(np.float32)).double().requires_grad_()
    v_features = torch.from_numpy(formula("v_features", BATCH * 512).astype(np.float32)).double().reshape(BATCH, 512)
    pooled = model.vision_model(pixel_values=pixels).pooler_output
    embeds = model.visual_projection(pooled)
    features = embeds / embeds.norm(dim=-1, keepdim=True)
    (features * v_features).sum().backward()
    v_pixels = pixels.grad
    return {
        "embeds": embeds, "features": features, "v_pixels_kept": v_pixels[:, :, ROW::STEP, COLUMN::STEP],
        "v_pixels_norm": v_pixels.flatten(1).norm(dim=1),
    }


def texts(model):
    """Features of two texts of different lengths, padded as tokenizers pad."""
    begin, end, pad = TEXT["bos_token_id"], TEXT["eos_token_id"], TEXT["pad_token_id"]
    rows = []
    for number, length in enumerate(TEXT_LENGTHS):
        inner = 1 + np.floor((formula(f"input_ids.{number}", length - 2) + 1.0) / 2.0 * (begin - 1)).astype(np.int64)
        rows.append([begin, *inner, end] + [pad] * (PLACES - length))
    ids = torch.tensor(rows)
    embeds = model.text_projection(model.text_model(input_ids=ids).pooler_output)
    return {"input_ids": ids, "text_embeds": embeds, "text_features": embeds / embeds.norm(dim=-1, keepdim=True)}


def main():
    torch.set_num_threads(1)
    config = CLIPConfig(text_config=TEXT, vision_config={}, projection_dim=512, attn_implementation="eager")
    model = CLIPModel(config).eval()
    state = {k: torch.from_numpy(weight(k, tuple(v.shape))) for k, v in model.state_dict().items() if "position_ids" not in k}
    model.load_state_dict(state, strict=False)
    missing = set(model.state_dict()) - set(state)
    assert all("position_ids" in key for key in missing), missing
    model = model.double()
    out = {}
    for name, value in {**images(model), **texts(model)}.items():
        kind = np.float32 if value.is_floating_point() else np.int64
        out[name] = np.ascontiguousarray(value.detach().numpy().astype(kind))
        print(name, value.shape, float(np.abs(out[name]).max()))
    save_file(out, Path(__file__).parents[1] / "clip_vit_b32.safetensors")


if __name__ == "__main__":
    main()
