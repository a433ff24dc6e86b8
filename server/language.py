"""The words of pages and mails: English as it stands in templates and code, other languages from web/locale (ADR 0025).

A language is a gettext PO file for each part of the site: two people who add pages seldom touch the same file.
"""

from __future__ import annotations

from functools import cache
from gettext import NullTranslations
from pathlib import Path

from babel.messages.pofile import read_po

from server.accounts.preferences import Language
from server.resources import folder

SCRIPTS = "js.po"
"""The part that the page hands to its scripts."""


def files(language: Language) -> list[Path]:
    """The catalogues of a language, in order."""
    return sorted((folder("web") / "locale" / language).glob("*.po"))


class Catalogue(NullTranslations):
    """The messages of one language; a message that is missing stays English."""

    def __init__(self, messages: dict[str, str | tuple[str, ...]]) -> None:
        super().__init__()
        self._messages = messages

    def gettext(self, message: str) -> str:
        found = self._messages.get(message, message)
        return found if isinstance(found, str) else found[0]

    def ngettext(self, msgid1: str, msgid2: str, n: int) -> str:
        found = self._messages.get(msgid1, (msgid1, msgid2))
        return found if isinstance(found, str) else found[n != 1]


def _read(path: Path, language: Language) -> dict[str, str | tuple[str, ...]]:
    found: dict[str, str | tuple[str, ...]] = {}
    with path.open("rb") as file:
        for message in read_po(file, locale=language):
            if not message.id or not message.string:
                continue
            name = message.id if isinstance(message.id, str) else message.id[0]
            text = message.string
            found[str(name)] = text if isinstance(text, str) else tuple(text)
    return found


@cache
def catalogue(language: Language) -> Catalogue:
    """All parts of a language."""
    messages: dict[str, str | tuple[str, ...]] = {}
    for path in files(language):
        messages |= _read(path, language)
    return Catalogue(messages)


@cache
def script_words(language: Language) -> dict[str, str]:
    """What scripts say in another language than English."""
    path = folder("web") / "locale" / language / SCRIPTS
    return {k: v for k, v in _read(path, language).items() if isinstance(v, str)} if path.exists() else {}
