"""A QR code for a page, as one path of an SVG."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from reportlab.graphics.barcode import qrencoder

QUIET = 4
"""Modules of margin that ISO/IEC 18004 wants around the code."""


@dataclass(frozen=True)
class Code:
    """The dark modules, one unit each, with the margin around them."""

    size: int
    d: str


def qr_code(text: str) -> Code:
    """The smallest code that holds the text, error correction M."""
    made: Any = qrencoder.QRCode(None, qrencoder.QRErrorCorrectLevel.M)  # no types
    made.addData(text)
    made.make()
    count: int = made.getModuleCount()
    rows: list[list[bool]] = made.modules
    d = "".join(f"M{x + QUIET} {y + QUIET}h1v1h-1z" for y, row in enumerate(rows) for x, dark in enumerate(row) if dark)
    return Code(count + 2 * QUIET, d)
