"""What a trained Deformable-3DGS network makes of 40 random splats, in f64 with numpy 2; needs ../shared."""

import collections
import io
import json
import pickle
import struct
import zipfile

import numpy as np

SOURCE = "../../../../shared/data/pth/deformable_standup_run256/deform.pth"
TIMES = [0.0, 0.37, 1.0]


class Weights(pickle.Unpickler):
    """Reads a state dict of our own data set without torch; calls nothing that a file names."""

    def __init__(self, archive, name):
        super().__init__(io.BytesIO(archive.read(name)))
        self.archive, self.root = archive, name.removesuffix("data.pkl")

    def find_class(self, module, name):
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if name == "_rebuild_tensor_v2":
            return lambda storage, offset, size, stride, *_: storage[offset:][: int(np.prod(size))].reshape(size)
        return name

    def persistent_load(self, pid):
        return np.frombuffer(self.archive.read(f"{self.root}data/{pid[2]}"), np.float32)


archive = zipfile.ZipFile(SOURCE)
names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
net = {name: np.asarray(value, np.float64) for name, value in Weights(archive, names[0]).load().items()}


def linear(name, x):
    return x @ net[f"{name}.weight"].T + net[f"{name}.bias"]


def encode(x):
    waves = [wave(x * 2.0**k) for k in range(10) for wave in (np.sin, np.cos)]
    return np.concatenate([x, *waves], axis=-1)


rng = np.random.default_rng(0)
n = 40
splats = {
    "means": rng.uniform(-1, 1, (n, 3)),
    "scales": rng.uniform(-5, -2, (n, 3)),
    "quats": rng.uniform(-1, 1, (n, 4)),
}
splats = {name: value.astype(np.float32) for name, value in splats.items()}
means, scales, quats = (splats[name].astype(np.float64) for name in ("means", "scales", "quats"))
out = dict(splats, times=np.asarray(TIMES, np.float32))
for number, time in enumerate(np.float32(TIMES)):
    embedded = np.concatenate([encode(means), np.repeat(encode(np.full((1, 1), np.float64(time))), n, 0)], axis=-1)
    h = embedded
    for layer in range(8):
        h = np.maximum(linear(f"linear.{layer}", h), 0)
        if layer == 4:
            h = np.concatenate([embedded, h], axis=-1)
    unit = quats / np.linalg.norm(quats, axis=-1, keepdims=True)
    out[f"means.{number}"] = means + linear("gaussian_warp", h)
    out[f"deviations.{number}"] = np.exp(scales) + linear("gaussian_scaling", h)
    out[f"quats.{number}"] = unit + linear("gaussian_rotation", h)

header, body = {}, b""
for name, value in out.items():
    data = np.ascontiguousarray(value, np.float32).tobytes()
    header[name] = {"dtype": "F32", "shape": list(value.shape), "data_offsets": [len(body), len(body) + len(data)]}
    body += data
text = json.dumps(header).encode()
text += b" " * (-len(text) % 8)
with open("../warp.safetensors", "wb") as file:
    file.write(struct.pack("<Q", len(text)) + text + body)
