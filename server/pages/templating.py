"""Jinja2 for the pages: an environment for each language, escaping on, and the formats every page uses."""

from __future__ import annotations

import datetime as dt
import math
from functools import partial
from typing import Any, Literal, Protocol, cast
from urllib.parse import unquote

import orjson
from fastapi import FastAPI
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse

from server import static_files
from server.accounts.places import seen
from server.accounts.preferences import LANGUAGES, Language
from server.language import catalogue, script_words
from server.pages.frame import MEASURES, language_of, preferences_of
from server.resources import folder


class Render(Protocol):
    """``app.state.render``: an HTML response from a template and its context, in the language of who asks."""

    def __call__(
        self, name: str, context: dict[str, Any], *, connection: HTTPConnection, status_code: int = 200
    ) -> HTMLResponse: ...


def install(app: FastAPI) -> None:
    """Give the app its `render`."""
    environments = {language: environment(language) for language in LANGUAGES}

    def render(
        name: str, context: dict[str, Any], *, connection: HTTPConnection, status_code: int = 200
    ) -> HTMLResponse:
        language = language_of(connection)
        units = preferences_of(connection).units
        shared = {"language": language, "measures": MEASURES[units], "units_name": units}
        page = environments[language].get_template(name).render({**shared, **context})
        headers = {"Content-Language": language, "Vary": "Accept-Language, Cookie"}
        return HTMLResponse(page, status_code, headers)

    app.state.render = render


def environment(language: Language) -> Environment:
    """Templates as one language shows them."""
    made = Environment(
        loader=FileSystemLoader(folder("web") / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.i18n"],
    )
    words = script_words(language)
    shared: dict[str, Any] = {
        "seen": seen,
        "static": static_files.address(),
        "said": catalogue(language).gettext,  # texts of variables; a call of _ would format them
        "reason": partial(_reason, language),
        "script_words": orjson.dumps(words).decode() if words else "",
    }
    cast("dict[str, Any]", made.globals).update(shared)
    made.filters.update(
        moment=moment,
        number=partial(number, language=language),
        short=partial(short, language=language),
        written=partial(written, language=language),
        duration=duration,
        unquote=lambda value: unquote(str(value)),
    )
    # The extension adds it to the environment at run time.
    cast("Any", made).install_gettext_translations(catalogue(language), newstyle=True)
    return made


def _reason(language: Language, key: str, sentence: str) -> str:
    """A sentence of an estimate, which the catalogues have under the name of its reason."""
    found = catalogue(language).gettext(key)
    return sentence if found == key else found


def renderer(app: FastAPI) -> Render:
    """The app's `render`, typed."""
    return cast("Render", app.state.render)


def moment(at: dt.datetime, style: Literal["full", "short", "ago"] = "full") -> Markup:
    """A time element in UTC; the page shows it in the reader's zone (web/static/js/time.js)."""
    utc = at.astimezone(dt.UTC)
    iso = utc.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    words = f"{utc:%Y-%m-%d %H:%M} UTC"
    return Markup('<time datetime="{}" data-style="{}">{}</time>').format(iso, style, words)


def number(value: float, digits: int = 0, *, sign: bool = False, language: Language = "en") -> str:
    """Fixed decimals as the language writes them, a real minus sign, thin spaces between thousands, never "-0"."""
    text = f"{value:{'+' if sign else ''},.{digits}f}"
    if not any(c in "123456789" for c in text):
        text = text.lstrip("+-")
    return written(text.replace(",", "\N{NARROW NO-BREAK SPACE}").replace("-", "\N{MINUS SIGN}"), language=language)


def written(figures: str, *, language: Language = "en") -> str:
    """Figures with the language's decimal sign."""
    return figures.replace(".", ",") if language == "it" else figures


def short(value: float, digits: int = 3, *, language: Language = "en") -> str:
    """So many significant digits of a number of any size: 0.00132, 32 768, 4.2 × 10⁻⁷."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e6:
        places = 0 if value == 0.0 else max(0, digits - 1 - math.floor(math.log10(abs(value))))
        return number(value, places, language=language)
    mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
    raised = str(int(power)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{number(float(mantissa), digits - 1, language=language)} × 10{raised}"


def duration(seconds: float) -> str:
    """Hours and minutes, or minutes and seconds below an hour."""
    whole = round(seconds)
    hours, minutes, rest = whole // 3600, whole // 60 % 60, whole % 60
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"
