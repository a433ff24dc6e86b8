"""Looking at 3D views: how long they may take, what they log, and which colours they show."""

from __future__ import annotations

import io
import time
from collections.abc import Callable

import numpy as np
from PIL import Image
from playwright.sync_api import Locator, Page

# Software rendering on a busy machine: viser's page needs seconds to come up.
PATIENCE_MS = 90_000
# What viser's client says of its own libraries and of a machine without a graphics card.
CHATTER = ("THREE.", "WebGL", "GL Driver")


def coloured(picture: bytes) -> dict[str, int]:
    """How many pixels are clearly red, green, blue and orange."""
    rgb = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    return {
        "red": int(((r > g + 60) & (np.abs(g - b) < 45)).sum()),
        "green": int(((g > r + 40) & (g > b + 15)).sum()),
        "blue": int(((b > r + 60) & (b > g + 25)).sum()),
        "orange": int(((r > g + 40) & (g > b + 35)).sum()),
    }


def wait_true(page: Page, expression: str) -> None:
    """Until an expression holds in the page; asked from outside, because the pages' policy lets no string be run."""
    until = time.monotonic() + PATIENCE_MS / 1000.0
    while not page.evaluate(expression):
        assert time.monotonic() < until, expression


def wait_coloured(scene: Locator, enough: Callable[[dict[str, int]], bool]) -> dict[str, int]:
    """Colours of a scene once there is enough of them: a picture takes a frame, so looking again is the wait."""
    until = time.monotonic() + PATIENCE_MS / 1000.0
    while True:
        drawn = coloured(scene.screenshot(timeout=PATIENCE_MS))
        if enough(drawn) or time.monotonic() > until:
            assert enough(drawn), drawn
            return drawn
