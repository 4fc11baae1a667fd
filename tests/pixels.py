"""Test helper: the colours of views in a screenshot."""

import io
import time

import numpy as np
from PIL import Image

from scan3d_twin.recording.colours import view_colour

SOON = 120_000
"""Patience of every page with a busy computer, which draws without a graphics card [ms]."""
SMALL = {"width": 700, "height": 400}
"""Window that a computer without a graphics card draws quickly."""
SCENE = {"x": 0, "y": 150, "width": 370, "height": 250}
"""The part of it that shows neither controls nor messages."""


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


def until(page, holds):
    """Return whether ``holds()`` becomes true on ``page`` before patience ends."""
    end = time.monotonic() + SOON / 1000
    while not holds() and time.monotonic() < end:
        page.wait_for_timeout(50)
    return holds()


def drawn(page, wanted, views=(0, 1, 2)):
    """Return which of ``views`` show their colours, once it is ``wanted`` or patience has ended."""
    end = time.monotonic() + SOON / 1000
    while True:
        picture = page.screenshot(clip=SCENE)
        seen = {k for k in views if share_of(picture, view_colour(k)) > 0.002}
        if seen == wanted or time.monotonic() > end:
            return seen
        page.wait_for_timeout(500)
