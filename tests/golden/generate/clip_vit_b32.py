"""Writes tests/golden/clip_vit_b32.safetensors: a ViT-B/32-shaped CLIP image tower with formula weights.

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

TEXT = {
    "vocab_size": 8, "hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1,
    "num_attention_heads": 1, "max_position_embeddings": 4, "bos_token_id": 6, "eos_token_id": 7, "pad_token_id": 0,
}


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


def main():
    torch.set_num_threads(1)
    config = CLIPConfig(text_config=TEXT, vision_config={}, projection_dim=512, attn_implementation="eager")
    model = CLIPModel(config).eval()
    state = {k: torch.from_numpy(weight(k, tuple(v.shape))) for k, v in model.state_dict().items() if "position_ids" not in k}
    model.load_state_dict(state, strict=False)
    missing = set(model.state_dict()) - set(state)
    assert all("position_ids" in key for key in missing), missing
    model = model.double()
    pixels = 2.0 * formula("pixel_values", BATCH * 3 * SIDE * SIDE).reshape(BATCH, 3, SIDE, SIDE)
    pixels = torch.from_numpy(pixels.astype(np.float32)).double().requires_grad_()
    v_features = torch.from_numpy(formula("v_features", BATCH * 512).astype(np.float32)).double().reshape(BATCH, 512)
    pooled = model.vision_model(pixel_values=pixels).pooler_output
    embeds = model.visual_projection(pooled)
    features = embeds / embeds.norm(dim=-1, keepdim=True)
    (features * v_features).sum().backward()
    v_pixels = pixels.grad
    kept = v_pixels[:, :, ROW::STEP, COLUMN::STEP]
    out = {
        "embeds": embeds, "features": features, "v_pixels_kept": kept,
        "v_pixels_norm": v_pixels.flatten(1).norm(dim=1),
    }
    out = {k: np.ascontiguousarray(v.detach().numpy().astype(np.float32)) for k, v in out.items()}
    for name, value in out.items():
        print(name, value.shape, float(np.abs(value).max()))
    save_file(out, Path(__file__).parents[1] / "clip_vit_b32.safetensors")


if __name__ == "__main__":
    main()
