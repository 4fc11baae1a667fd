"""What colours a screenshot shows."""

import io

import numpy as np
from PIL import Image


def pixels(png):
    """Return the picture of a PNG file (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int64)


def share_of(png, colour, within=30):
    """Return the share of pixels with the hue of ``colour``, #rrggbb, whatever the light."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], float)
    flat = pixels(png).reshape(-1, 3).astype(float)
    bright = np.maximum(1.0, flat @ wanted) / (wanted @ wanted)
    off = np.abs(flat - bright[:, None] * wanted).max(axis=1)
    return np.mean((off < within * bright) & (bright > 0.4) & (bright < 1.4))
