"""Texts in files that people open in a spreadsheet."""

from __future__ import annotations


def spreadsheet_text(text: str | None) -> str:
    """A name or note as a spreadsheet takes it for text, never for a formula."""
    text = text or ""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text
