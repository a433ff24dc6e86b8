"""Every word of the pages can be said in every language."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from babel.messages.extract import extract_from_dir
from babel.messages.pofile import read_po

from nav_core.mounting.reasons import REASONS
from nav_core.mounting.thesis import REASONS as THESIS_REASONS
from server.accounts.preferences import LANGUAGES, Preferences, View, preferred
from server.errors import ProblemError
from server.installations.blank import REASON_CODES
from server.language import SCRIPTS, catalogue, files
from server.pages.templating import environment, number
from server.problems import DESCRIBED, PAGES, InternalProblemError
from server.resources import folder

WEB = folder("web")
ROOT = WEB.parent
SCRIPT_FILES = sorted((WEB / "static" / "js").rglob("*.js"))
TEMPLATES = sorted((WEB / "templates").rglob("*.html"))
OTHERS = [language for language in LANGUAGES if language != "en"]
KEYWORDS = {"_": None, "gettext": None, "ngettext": (1, 2), "marked": None}

# What is the same in every language: units, names of formats and standards, symbols.
SAME = re.compile(
    r"j k|Enter|Esc|Scatola|km/h|mph|PDF|CSV|JSON|MCAP|Parquet|49 CFR 563|SHA-256|UTC|GPS|API|Rapporto, PDF|Delta-V|Hz|"
    r"PUT /api/\S+|POST /api/\S+|scatola doctor|m/s²|[θφψ]|\b(?:km|mi|MB|GB|ms|min|s|h|g|m|x|y|z|V|A)\b"
)
TEXT_ATTRIBUTE = re.compile(r"""\b(?:title|aria-label|placeholder|alt|data-label|data-empty)="([^"]*)\"""")
NEST = re.compile(r"\{#.*?#\}|\{%.*?%\}|\{\{.*?\}\}", re.DOTALL)


def bare_texts(source: str) -> list[str]:
    """Texts of a template, between tags or in attributes that people read, which no call translates."""
    plain = NEST.sub("\x00", source)
    plain = re.sub(r"<(script|style)\b.*?</\1>", "", plain, flags=re.DOTALL)
    plain = re.sub(r"""\bdata-(?!label|empty)[\w-]+="[^"]*\"""", "", plain)
    texts = [*TEXT_ATTRIBUTE.findall(plain), *re.split(r"<[^>]*>", plain)]
    found = (re.sub(r"&\w+;|\x00", " ", SAME.sub(" ", text)).strip() for text in texts)
    return [text for text in found if re.search(r"[^\W\d_]", text)]


def literal_words(source: str) -> list[str]:
    """Texts in expressions of a template that nothing translates: quoted, with a blank or a capital letter."""
    found: list[str] = []
    for code in re.findall(r"\{[{%](.*?)[%}]\}", source, re.DOTALL):
        for before, text in re.findall(r"""(_\(\s*|marked\(\s*|, )?"([^"]*)\"""", code):
            reads = re.fullmatch(r"[A-Z][a-z]+|[A-Za-z]+ [a-z ]+[.]?", text)
            if reads and not before.startswith(("_", "marked")) and not SAME.fullmatch(text):
                if f', "{text}"' in code and "ngettext" in code:
                    continue
                found.append(text)
    return found


def wanted(*folders: Path, suffixes: tuple[str, ...]) -> set[str]:
    """Messages of the sources."""
    methods = [("**.html", "jinja2.ext:babel_extract"), ("**.py", "python")]
    messages: set[str] = set()
    for place in folders:
        found = extract_from_dir(
            str(place),
            [(pattern, method) for pattern, method in methods if pattern.endswith(suffixes)],
            options_map={"**.html": {"trimmed": "true", "silent": "false"}},
            keywords=KEYWORDS,
        )
        messages |= {message if isinstance(message, str) else message[0] for _, _, message, _, _ in found}
    return messages


def kept(path: Path, language: str) -> dict[str, object]:
    with path.open("rb") as file:
        return {m.id if isinstance(m.id, str) else m.id[0]: m.string for m in read_po(file, locale=language) if m.id}


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.name)
def test_no_text_of_a_template_is_untranslated(path):
    source = path.read_text()
    assert bare_texts(source) == []
    assert literal_words(source) == []


@pytest.mark.parametrize("language", OTHERS)
def test_a_language_says_all_and_nothing_besides(language):
    pages = wanted(WEB / "templates", ROOT / "server", suffixes=(".html", ".py"))
    scripts = {text for path in SCRIPT_FILES for text in re.findall(r'\bt\("([^"]*)"', path.read_text())}
    reasons = {f"reason:{code}" for code in (*REASONS, *THESIS_REASONS, *REASON_CODES)}
    pages |= {error.title for error in (ProblemError, *DESCRIBED, InternalProblemError) if error.code not in PAGES}
    said = {name: text for path in files(language) for name, text in kept(path, language).items()}
    of_scripts = kept(WEB / "locale" / language / SCRIPTS, language)
    assert sorted((pages | reasons | scripts) - said.keys()) == []
    assert sorted(scripts - of_scripts.keys()) == [], "a script's words belong into js.po"
    assert sorted(said.keys() - pages - reasons - scripts) == [], "nobody says this any more"
    assert [name for name, text in said.items() if not text or not all(text)] == []


@pytest.mark.parametrize("language", OTHERS)
def test_places_for_values_are_the_same(language):
    def places(text: str) -> set[str]:
        return set(re.findall(r"%\(\w+\)s|\{\w*\}", text))

    for path in files(language):
        for name, text in kept(path, language).items():
            for one in [text] if isinstance(text, str) else list(text):
                assert name.startswith("reason:") or places(one) == places(name), name


def test_scripts_say_nothing_that_is_not_translated():
    for path in SCRIPT_FILES:
        code = re.sub(r"/\*.*?\*/|^\s*//.*?$|(?<=[;{}\s])// .*?$", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
        code = re.sub(r'\bt\("[^"]*"|(?:throw )?new Error\([^)]*\)', "", code)
        found = re.findall(r'"([A-Z][a-z]+(?: [a-z][^"]*)?)"', code)
        names = {"Point", "Feature", "LineString", "Polygon", "Enter", "Escape", "Accept", "GET", "POST"}
        assert [text for text in found if text not in names | {"MultiLineString", "FeatureCollection"}] == [], path.name


def test_plurals_and_numbers_of_italian():
    italian = catalogue("it")
    assert italian.gettext("Fleet") == "Flotta"
    assert italian.gettext("of no catalogue") == "of no catalogue"
    assert number(1234.5, 1, language="it") == "1\N{NARROW NO-BREAK SPACE}234,5"
    page = environment("it").from_string('{{ _("Fleet") }} {{ 2.5 | number(1) }}').render()
    assert page == "Flotta 2,5"


@pytest.mark.parametrize(
    ("asked", "language"),
    [
        ("", "en"),
        ("it", "it"),
        ("it-IT,it;q=0.9,en;q=0.8", "it"),
        ("de, en;q=0.5, it;q=0.7", "it"),
        ("en-GB,it;q=0.9", "en"),
        ("it;q=0, en", "en"),
        ("it;q=nonsense", "en"),
        ("*", "en"),
    ],
)
def test_the_browser_asks_for_a_language(asked, language):
    assert preferred(asked) == language


def test_preferences_come_back_as_they_were_kept():
    kept_ones = Preferences("it", "imperial").with_view(View("fleet", "Moved", "show=moved"))
    assert Preferences.from_json(kept_ones.to_json()) == kept_ones
    assert Preferences.from_json({"language": "xx", "units": "ells"}) == Preferences()
    assert kept_ones.with_view(View("fleet", "Moved", "show=all")).views_of("fleet") == [
        View("fleet", "Moved", "show=all")
    ]
    assert kept_ones.without_view("fleet", "Moved").views == ()
