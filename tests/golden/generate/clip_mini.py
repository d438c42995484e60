"""Writes tests/golden/clip_mini.safetensors: features and pixel gradients of the built-in miniature CLIP.

Two smooth random pictures and two token sequences, one of them as long as a message of 48 bits. In float64, stored as
float32.
"""

import torch
import torch.nn.functional as F
from common import FOLDER, save
from transformers import CLIPModel

IMAGES, SIDE, WIDTH = 2, 64, 512
# Tokens of each text with begin and end; the rest of its 77 places is padding, which nothing may read.
TEXT_LENGTHS, PLACES, PADDING = (9, 50), 77, 0
MEAN, STD = [0.48145466, 0.4578275, 0.40821073], [0.26862954, 0.26130258, 0.27577711]

torch.set_num_threads(1)
generator = torch.Generator().manual_seed(0)
model = CLIPModel.from_pretrained(
    FOLDER.parents[1] / "engine/assets/mini-clip", dtype=torch.float64, attn_implementation="eager"
).eval()
text = model.config.text_config

coarse = torch.rand((IMAGES, 3, 9, 9), generator=generator)
pictures = F.interpolate(coarse, size=(SIDE, SIDE), mode="bicubic", align_corners=True).clamp(0, 1)
pixels = (pictures - torch.tensor(MEAN)[:, None, None]) / torch.tensor(STD)[:, None, None]
v_features = torch.rand((IMAGES, WIDTH), generator=generator) * 2 - 1

ids = torch.full((len(TEXT_LENGTHS), PLACES), PADDING)
for row, length in zip(ids, TEXT_LENGTHS, strict=True):
    row[0], row[length - 1] = text.bos_token_id, text.eos_token_id
    row[1 : length - 1] = torch.randint(1, text.bos_token_id, (length - 2,), generator=generator)


def unit(embeds):
    """Rows divided by their lengths."""
    return embeds / embeds.norm(dim=-1, keepdim=True)


x = pixels.double().requires_grad_()
image_embeds = unit(model.visual_projection(model.vision_model(pixel_values=x).pooler_output))
(image_embeds * v_features.double()).sum().backward()
text_embeds = unit(model.text_projection(model.text_model(input_ids=ids).pooler_output))
save(
    "clip_mini",
    {
        "pixel_values": pixels,
        "v_image_embeds": v_features,
        "image_embeds": image_embeds,
        "v_pixel_values": x.grad,
        "input_ids": ids,
        "text_embeds": text_embeds,
    },
)
