"""The event report as PDF, made from the canonical document alone.

The same document gives the same bytes in one environment: fonts are bundled and no clock is read.
"""

from __future__ import annotations

import datetime as dt
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast
from xml.sax.saxutils import escape

from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    CondPageBreak,
    Flowable,
    Frame,
    KeepTogether,
    PageBreak,
    PageTemplate,
    Paragraph,
    Spacer,
)

from server.events.exports import utc_t0
from server.reports import parts
from server.reports.figures import sentences
from server.reports.paper import BOLD, INK, LINE, MONO, MUTED, PLAIN, load_fonts
from server.reports.words import Language, Words

MOST_PAGES = 5
MARGIN, TOP, BOTTOM = 18 * mm, 24 * mm, 18 * mm
WIDTH = A4[0] - 2 * MARGIN


@dataclass(frozen=True, slots=True)
class Heading:
    """What the report names that the document does not: people's names of things."""

    event_id: str
    revision: int
    event_sha256: str
    device_name: str
    vehicle_name: str | None = None
    plate: str | None = None


def report_pdf(
    document: dict[str, Any],
    heading: Heading,
    language: Language,
    contradictions: Sequence[tuple[str, str]] | None = None,
) -> bytes:
    """Three to five pages about one revision of an event.

    `contradictions` are codes and sentences about the data around the event, which are no part of the document; None
    where nobody looked for any.
    """
    load_fonts()
    # The archive of evidence has all uploads; the report as many as leave it short.
    content = b""
    for links in parts.LINKS:
        content, pages = _built(document, heading, Words(language), contradictions, links)
        if pages <= MOST_PAGES:
            break
    return content


def _built(
    document: dict[str, Any],
    heading: Heading,
    words: Words,
    contradictions: Sequence[tuple[str, str]] | None,
    links: int,
) -> tuple[bytes, int]:
    """The report with so many uploads listed, and its number of pages."""
    sink = io.BytesIO()
    kind = words(document["event"]["kind"])
    template = blank(sink, title=f"{words('title')}: {kind}", subject=heading.event_id, language=words.language)
    frame = Frame(MARGIN, BOTTOM, WIDTH, A4[1] - TOP - BOTTOM, 0, 0, 0, 0, id="page")
    template.addPageTemplates([PageTemplate(id="page", frames=[frame])])

    class Numbered(Canvas):
        """Writes head and foot when the number of pages is known."""

        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._kept: list[dict[str, Any]] = []

        def showPage(self) -> None:  # reportlab's name
            self._kept.append(dict(self.__dict__))
            cast("Any", self)._startPage()  # noqa: SLF001  reportlab's own recipe for "page x of y"

        def save(self) -> None:
            for number, state in enumerate(self._kept, start=1):
                self.__dict__.update(state)
                _head_and_foot(self, words, heading, kind, number, len(self._kept))
                super().showPage()
            super().save()

    template.build(_story(document, heading, words, contradictions, links), canvasmaker=Numbered)
    return sink.getvalue(), template.page


def _head_and_foot(canvas: Any, words: Words, heading: Heading, kind: str, page: int, pages: int) -> None:
    letterhead(canvas, f"{words('title')} · {kind}", words("foot", hash=heading.event_sha256))
    named = f"{words('event')} {heading.event_id} · {words('revision')} {heading.revision}"
    canvas.setFont(PLAIN, 8)
    canvas.drawRightString(A4[0] - MARGIN, A4[1] - 14 * mm, named)
    canvas.drawRightString(A4[0] - MARGIN, 10 * mm, words("page", page=page, pages=pages))


def blank(sink: io.BytesIO, *, title: str, subject: str, language: Language) -> BaseDocTemplate:
    """A document of our paper, without pages; it says nothing of when it was made."""
    return BaseDocTemplate(
        sink,
        pagesize=A4,
        leftMargin=MARGIN,
        rightMargin=MARGIN,
        topMargin=TOP,
        bottomMargin=BOTTOM,
        title=title,
        author="Scatola",
        subject=subject,
        lang=language,
        invariant=1,
    )


def letterhead(canvas: Any, name: str, foot: str) -> None:
    """What stands on every page: whose paper it is, what it is, and the hash it goes by."""
    width, height = A4
    canvas.setFillColor(MUTED)
    canvas.setFont(BOLD, 8)
    canvas.drawString(MARGIN, height - 14 * mm, "SCATOLA")
    canvas.setFont(PLAIN, 8)
    canvas.drawString(MARGIN + 46, height - 14 * mm, name)
    canvas.setStrokeColor(LINE)
    canvas.setLineWidth(0.5)
    canvas.line(MARGIN, height - 16 * mm, width - MARGIN, height - 16 * mm)
    canvas.line(MARGIN, 14 * mm, width - MARGIN, 14 * mm)
    canvas.setFont(MONO, 6)
    canvas.drawString(MARGIN, 10 * mm, foot)


def _style(
    name: str, size: float, *, font: str = PLAIN, colour: Any = INK, before: float = 0, after: float = 3
) -> ParagraphStyle:
    return ParagraphStyle(
        name, fontName=font, fontSize=size, leading=1.36 * size, textColor=colour, spaceBefore=before, spaceAfter=after
    )


TITLE = _style("title", 20, font=BOLD, after=6)
SECTION = _style("section", 12, font=BOLD, before=12, after=5)
BODY = _style("body", 9.5, after=4)
SMALL = _style("small", 8, colour=MUTED, after=3)


def _story(
    document: dict[str, Any],
    heading: Heading,
    words: Words,
    contradictions: Sequence[tuple[str, str]] | None,
    links: int,
) -> list[Flowable]:
    event, curves = document["event"], document["curves"]
    at = dt.datetime.fromtimestamp(round(utc_t0(document), 2), dt.UTC)
    severe = curves["pulse"] is not None
    story: list[Flowable] = [Paragraph(words(event["kind"]), TITLE)]
    story.append(parts.subject_table(document, heading, words, at, WIDTH))
    story.append(Paragraph(words("summary"), SECTION))
    if severe:
        story += [parts.key_figures(document, words, WIDTH), Spacer(1, 8)]
    story += [Paragraph(sentence, BODY) for sentence in sentences(document, words, at)]
    if severe:
        sketch = [Paragraph(words("sketch"), SECTION), parts.sketch(document, words, WIDTH)]
        story += [KeepTogether(sketch), PageBreak(), Paragraph(words("curves"), SECTION)]
        story += parts.pulse_plots(curves["pulse"], words, WIDTH)
    if curves["trajectory"] is not None:
        story += [parts.speed_plot(curves["trajectory"], words, WIDTH), PageBreak(), Paragraph(words("way"), SECTION)]
        maps, note = parts.maps(document, words, WIDTH)
        story += [maps, Spacer(1, 4), Paragraph(note, SMALL)]
    elif severe:
        story += [Paragraph(words("no_way"), BODY)]
    if event["driver"] is not None:
        story.append(KeepTogether([Paragraph(words("driver"), SECTION), *parts.driver_tables(event, words, WIDTH)]))
    story += [CondPageBreak(90 * mm), Paragraph(words("numbers"), SECTION), parts.numbers_table(event, words, WIDTH)]
    if event["injuries"]:
        risk = [Paragraph(words("risk"), SECTION), parts.risk_table(event, words, WIDTH), Spacer(1, 3)]
        story.append(KeepTogether([*risk, Paragraph(words("risk_note"), SMALL)]))
    remarks = event["quality_details"]
    story.append(Paragraph(words("quality"), SECTION))
    story += [Paragraph("• " + words.remark(each["code"], each["detail"]), BODY) for each in remarks]
    if not remarks:
        story.append(Paragraph(words("q_good"), BODY))
    if contradictions is not None:
        story.append(Paragraph(words("contradictions"), SECTION))
        lines = ["• " + words.remark(code, detail) for code, detail in contradictions] or [words("contradictions_none")]
        story += [Paragraph(escape(line), BODY) for line in lines]
    story.append(KeepTogether([Paragraph(words("q_basis"), SECTION), parts.basis_table(document, words, WIDTH)]))
    story += [Paragraph(words("provenance"), SECTION), Paragraph(words("p_text"), BODY)]
    story += parts.provenance_tables(document, heading.event_sha256, words, WIDTH, links)
    story += [Spacer(1, 4), Paragraph(words("p_verify"), BODY)]
    story.append(KeepTogether([Paragraph(words("conventions"), SECTION), Paragraph(words("c_text"), SMALL)]))
    return story
