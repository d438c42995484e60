"""Shared by the golden generators: where and how they write."""

import pathlib

import torch
from safetensors.torch import save_file

FOLDER = pathlib.Path(__file__).resolve().parent.parent
MAX_BYTES = 256 * 1024


def save(name, tensors):
    """Writes tests/golden/<name>.safetensors: floats in f32, integers as they are."""
    path = FOLDER / f"{name}.safetensors"
    as_stored = {key: t.detach().float() if t.is_floating_point() else t for key, t in tensors.items()}
    save_file({key: t.contiguous() for key, t in as_stored.items()}, path)
    size = path.stat().st_size
    assert size <= MAX_BYTES, f"{path} has {size} bytes, more than {MAX_BYTES}"
    print(f"{path.name}: {size} bytes, torch {torch.__version__}")
