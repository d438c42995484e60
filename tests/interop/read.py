"""Reads files of guard4d with other people's programs: read.py PLY SAFETENSORS... prints what it found as JSON."""

import json
import sys

import numpy as np
from plyfile import PlyData
from safetensors.numpy import load_file

vertex = PlyData.read(sys.argv[1])["vertex"]
names = [p.name for p in vertex.properties]
sums = {name: float(np.asarray(vertex[name], np.float64).sum()) for name in ("x", "f_dc_0", "f_rest_44", "rot_0")}
tensors = [{name: list(t.shape) for name, t in load_file(path).items()} for path in sys.argv[2:]]
print(json.dumps({"splats": vertex.count, "properties": names, "sums": sums, "tensors": tensors}))
