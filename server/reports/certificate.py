"""The certificate of an installation as one page of PDF, from the certificate's document alone."""

from __future__ import annotations

import datetime as dt
import html
import io
from typing import Any, cast

from reportlab.graphics.barcode.qr import QrCodeWidget
from reportlab.graphics.shapes import Drawing
from reportlab.lib.pagesizes import A4
from reportlab.lib.units import mm
from reportlab.platypus import Flowable, Frame, PageTemplate, Paragraph, Spacer, Table

from server.installations.certificate import Certificate
from server.reports.paper import (
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    BOLD,
    INK,
    MUTED,
    HexColor,
    load_fonts,
    polyline,
)
from server.reports.parts import CELL, HASH, pairs, table
from server.reports.pdf import BODY, BOTTOM, MARGIN, SECTION, SMALL, TITLE, TOP, WIDTH, blank, letterhead
from server.reports.words import Language, Words
from server.view3d.axonometry import drawing

_AXES = {"x": AXIS_X, "y": AXIS_Y, "z": AXIS_Z}
_FACES = {"face0": HexColor("#f6b24a"), "face1": HexColor("#e0900f"), "face2": HexColor("#b97708")}
_ANGLES = (("x", "psi", "ψ"), ("y", "theta", "θ"), ("z", "phi", "φ"))
_QR = 30 * mm
_BESIDE = [
    ("VALIGN", (0, 0), (-1, -1), "MIDDLE"),
    ("LEFTPADDING", (0, 0), (0, -1), 0),
    ("RIGHTPADDING", (-1, 0), (-1, -1), 0),
]


def certificate_pdf(
    certificate: Certificate, cones_deg: list[float] | None, language: Language, *, address: str
) -> bytes:
    """One page; `address` is where the same certificate can be looked at, with its hash.  The same bytes each time."""
    load_fonts()
    words = Words(language)
    sink = io.BytesIO()
    title = f"{words('certificate')}: {certificate.device.name}"
    template = blank(sink, title=title, subject=certificate.id, language=language)

    def head_and_foot(canvas: Any, _template: Any) -> None:
        letterhead(canvas, words("certificate"), words("cert_foot", hash=certificate.sha256))

    frame = Frame(MARGIN, BOTTOM, WIDTH, A4[1] - TOP - BOTTOM, 0, 0, 0, 0, id="page")
    template.addPageTemplates([PageTemplate(id="page", frames=[frame], onPage=head_and_foot)])
    template.build(_story(certificate, cones_deg, words, address))
    return sink.getvalue()


def _story(certificate: Certificate, cones_deg: list[float] | None, words: Words, address: str) -> list[Flowable]:
    document, vehicle = certificate.document, certificate.vehicle
    mounting, vehicle_class = document["mounting"], "car" if vehicle is None else vehicle.vehicle_class
    at = certificate.installed_at.astimezone(dt.UTC)
    named = words("no_vehicle") if vehicle is None else f"{vehicle.name} ({words(vehicle_class)})"
    how = words(f"cert_{document['installation']['beginning']}")
    reason = document["installation"]["reason"]
    largest = max(mounting["sigma_deg"].values()) if mounting["sigma_deg"] else None
    subject = [
        (words("vehicle"), named),
        (words("plate"), (vehicle.plate if vehicle else None) or words("not_recorded")),
        (words("box"), f"{certificate.device.name} · {document['device_id']}"),
        (words("cert_installed"), f"{words.date(at.year, at.month, at.day)}, {at:%H:%M} UTC"),
        (words("cert_installer"), certificate.installer or words("not_recorded")),
        (words("cert_how"), f"{how}: {reason}" if reason else how),
    ]
    summary = words("cert_summary") if largest is None else words("cert_summary_sigma", sigma=words.number(largest, 1))
    beside = Table(
        [[Picture(vehicle_class, mounting["R_va"], 0.42 * WIDTH, 52 * mm), pairs(subject, 0.56 * WIDTH)]],
        colWidths=[0.43 * WIDTH, 0.57 * WIDTH],
        style=_BESIDE,
    )
    link = html.escape(address)
    verify = [Paragraph(words("cert_verify"), BODY), Paragraph(f'<link href="{link}">{link}</link>', HASH)]
    return [
        Paragraph(words("certificate"), TITLE),
        Paragraph(summary, BODY),
        Spacer(1, 6),
        beside,
        Paragraph(words("cert_mounting"), SECTION),
        _figures(mounting, cones_deg, words),
        Spacer(1, 3),
        Paragraph(words("cert_note"), SMALL),
        Paragraph(words("provenance"), SECTION),
        pairs(
            [
                (words("p_algorithm"), str(document["algorithm"])),
                (words("cert_data_at"), str(document["data_at"])),
                (words("p_inputs"), Paragraph(document["input_sha256"], HASH)),
                (words("cert_hash"), Paragraph(certificate.sha256, HASH)),
            ],
            WIDTH,
        ),
        Spacer(1, 8),
        Table([[_qr(address), verify]], colWidths=[_QR + 8, WIDTH - _QR - 8], style=_BESIDE),
    ]


def _figures(mounting: dict[str, Any], cones_deg: list[float] | None, words: Words) -> Table:
    """The angles, the three sigmas and the cones; and the matrix itself."""
    rows: list[list[Any]] = [
        [words("cert_axis"), words("cert_angle"), words("cert_sigma"), words("cert_cone"), words("cert_matrix")]
    ]
    for k, (axis, key, letter) in enumerate(_ANGLES):
        sigma = mounting["sigma_deg"]
        rows.append(
            [
                axis,
                f"{letter} {words.number(mounting['euler_deg'][key], 2, sign=True)}°",
                words("not_recorded") if sigma is None else f"± {words.number(sigma[axis], 2)}°",
                words("not_recorded") if cones_deg is None else f"± {words.number(cones_deg[k], 1)}°",
                Paragraph("  ".join(words.number(value, 6, sign=True) for value in mounting["R_va"][k]), CELL),
            ]
        )
    return table(rows, (0.08, 0.2, 0.17, 0.2, 0.35), WIDTH)


def _qr(text: str) -> Drawing:
    code: Any = QrCodeWidget(text, barLevel="M")
    left, bottom, right, top = cast("tuple[float, float, float, float]", code.getBounds())
    scale = _QR / (right - left), _QR / (top - bottom)
    picture: Any = Drawing(_QR, _QR, transform=[scale[0], 0, 0, scale[1], -left * scale[0], -bottom * scale[1]])
    picture.add(code)
    return picture


class Picture(Flowable):
    """The vehicle and its box in parallel projection."""

    def __init__(self, vehicle_class: str, R_va: list[list[float]], width: float, height: float) -> None:
        super().__init__()
        self._drawing = drawing(vehicle_class, R_va)
        self.width, self.height = width, height

    def draw(self) -> None:
        """Called by reportlab."""
        canvas, d = self.canv, self._drawing
        scale = min(self.width / d.width, self.height / d.height)

        def at(x: float, y: float) -> tuple[float, float]:
            return (x - d.left) * scale, self.height - (y - d.top) * scale

        for stroke in d.strokes:
            points = [at(x, y) for x, y in stroke.points]
            if stroke.kind in _FACES:
                path = canvas.beginPath()
                path.moveTo(*points[0])
                for point in points[1:]:
                    path.lineTo(*point)
                path.close()
                canvas.setFillColor(_FACES[stroke.kind])
                canvas.drawPath(path, stroke=0, fill=1)
            else:
                closed = [*points, points[0]] if stroke.closed else points
                polyline(canvas, closed, _AXES.get(stroke.kind, MUTED), 1.8 if stroke.kind in _AXES else 0.5)
        canvas.setFont(BOLD, 9)
        for name, x, y in d.letters:
            canvas.setFillColor(_AXES.get(name, INK))
            px, py = at(x, y)
            canvas.drawCentredString(px, py - 3, name)
