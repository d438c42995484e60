"""Golden of image/jpeg: Pillow's (libjpeg's) decoded pictures at 4:2:0, of a grey and of a colour picture."""

import io

import torch
from common import save
from PIL import Image

HEIGHT, WIDTH = 40, 56
rows = torch.arange(HEIGHT, dtype=torch.float32)[:, None].expand(HEIGHT, WIDTH)
columns = torch.arange(WIDTH, dtype=torch.float32)[None, :].expand(HEIGHT, WIDTH)
grey = 128 + 60 * torch.sin(columns / 3 + rows / 7) + 40 * torch.cos(rows / 4)
# Chroma changes slowly: libjpeg interpolates it between quads of pixels, which the kernel does not.
colour = torch.stack([grey, grey + 40 * torch.sin(rows / 35), grey + 40 * torch.cos(columns / 40 - rows / 50)], -1)
pictures = {"grey": grey[..., None].expand(HEIGHT, WIDTH, 3), "colour": colour}

tensors = {}
for name, picture in pictures.items():
    x = picture.round().clamp(0, 255).to(torch.uint8)
    tensors[f"{name}.x"] = x.float() / 255
    for quality in (10, 50, 90):
        file = io.BytesIO()
        Image.fromarray(x.numpy()).save(file, "jpeg", quality=quality, subsampling=2)
        y = torch.frombuffer(bytearray(Image.open(file).convert("RGB").tobytes()), dtype=torch.uint8)
        tensors[f"{name}.y{quality}"] = y.reshape(HEIGHT, WIDTH, 3).float() / 255
save("jpeg", tensors)
