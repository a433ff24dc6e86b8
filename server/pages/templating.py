"""Jinja2 for the pages: one environment per app, escaping on, and the formats every page uses."""

from __future__ import annotations

import datetime as dt
from typing import Any, Literal, Protocol, cast

from fastapi import FastAPI
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from starlette.responses import HTMLResponse

from server.resources import folder


class Render(Protocol):
    """``app.state.render``: an HTML response from a template and its context."""

    def __call__(self, name: str, context: dict[str, Any], *, status_code: int = 200) -> HTMLResponse: ...


def install(app: FastAPI) -> None:
    """Give the app its `render`."""
    environment = Environment(
        loader=FileSystemLoader(folder("web") / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(moment=moment, number=number, duration=duration)

    def render(name: str, context: dict[str, Any], *, status_code: int = 200) -> HTMLResponse:
        return HTMLResponse(environment.get_template(name).render(context), status_code=status_code)

    app.state.render = render


def renderer(app: FastAPI) -> Render:
    """The app's `render`, typed."""
    return cast("Render", app.state.render)


def moment(at: dt.datetime, style: Literal["full", "short", "ago"] = "full") -> Markup:
    """A time element in UTC; the page shows it in the reader's zone (web/static/js/time.js)."""
    iso = at.astimezone(dt.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    words = at.astimezone(dt.UTC).strftime("%d %b %Y, %H:%M:%S UTC")
    return Markup('<time datetime="{}" data-style="{}">{}</time>').format(iso, style, words)


def number(value: float, digits: int = 0, *, sign: bool = False) -> str:
    """Fixed decimals, a real minus sign, thin spaces between thousands, and never "-0"."""
    text = f"{value:{'+' if sign else ''},.{digits}f}"
    if not any(c in "123456789" for c in text):
        text = text.lstrip("+-")
    return text.replace(",", "\N{NARROW NO-BREAK SPACE}").replace("-", "\N{MINUS SIGN}")


def duration(seconds: float) -> str:
    """Hours and minutes, or minutes and seconds below an hour."""
    whole = round(seconds)
    hours, minutes, rest = whole // 3600, whole // 60 % 60, whole % 60
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"
