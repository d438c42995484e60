"""Shared by the golden generators: where and how they write."""

import pathlib

import torch
from safetensors.torch import save_file

FOLDER = pathlib.Path(__file__).resolve().parent.parent
MAX_BYTES = 256 * 1024


def save(name, tensors):
    """Writes tests/golden/<name>.safetensors in f32."""
    path = FOLDER / f"{name}.safetensors"
    save_file({key: t.detach().to(torch.float32).contiguous() for key, t in tensors.items()}, path)
    size = path.stat().st_size
    assert size <= MAX_BYTES, f"{path} has {size} bytes, more than {MAX_BYTES}"
    print(f"{path.name}: {size} bytes, torch {torch.__version__}")
