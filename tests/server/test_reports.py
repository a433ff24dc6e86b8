"""The report: both languages whole, the same bytes, quick, and nothing put where nothing is known."""

from __future__ import annotations

import dataclasses
import datetime as dt
import io
import re
import string
import time
from pathlib import Path

import pytest
import rich
from crash_world import braking, crash
from reportlab.pdfgen.canvas import Canvas

from nav_core.crash.injury import CURVES
from nav_core.events.record import Estimate
from nav_core.records import Remark
from server.events.canonical import settle, sha256
from server.events.document import document_of
from server.events.exports import edr_csv, edr_json
from server.reports import parts
from server.reports.figures import number_rows, sentences
from server.reports.paper import load_fonts
from server.reports.pdf import Heading, report_pdf
from server.reports.sketch import room_beside
from server.reports.words import ENGLISH, ITALIAN, ITALIAN_REMARKS, Words

NAV_CORE = Path(__file__).resolve().parents[2] / "nav_core"
INPUTS = {
    "batches": [
        {
            "chain_index": k,
            "stream": "burst" if k == 0 else "continuous",
            "sequence": k,
            "rows": 2000,
            "t_first_s": 10.0 * k,
            "t_last_s": 10.0 * k + 10.0,
            "body_sha256": f"{k:064x}",
            "column_sha256": f"{k + 99:064x}",
        }
        for k in range(20)
    ],
    "between_s": [98.5, 101.5],
    "mounting": {"status": "ready", "method": "whole-drive", "algorithm": "whole-drive/1", "input_sha256": "0" * 64},
    "vehicle_class": "car",
    "clock": {"source": "gnss", "utc_offset_s": 1772366400.0, "utc_drift": 0.0, "utc_sigma_s": 0.31},
}


def document_from(event) -> dict:
    return settle(document_of(event, INPUTS, device_id="0f6c" * 8, boot="boot-7"))


def heading(document) -> Heading:
    return Heading("ab" * 16, 2, sha256(document), "SC-0006", "Jeep Renegade", "GF 606 ZZ")


def pages(pdf: bytes) -> int:
    return len(re.findall(rb"/Type /Page\b(?!s)", pdf))


def test_both_catalogues_have_the_same_sentences_with_the_same_values():
    def fields(text: str) -> set[str]:
        return {name for _, name, _, _ in string.Formatter().parse(text) if name}

    assert ENGLISH.keys() == ITALIAN.keys()
    for key, text in ENGLISH.items():
        assert fields(text) == fields(ITALIAN[key]), key


def test_every_remark_of_the_reconstruction_is_known_in_italian():
    found: set[str] = set()
    for file in [*NAV_CORE.glob("crash/*.py"), *NAV_CORE.glob("events/*.py")]:
        found |= set(re.findall(r'Remark\(\s*"([a-z0-9_]+)"', file.read_text(encoding="utf-8")))
    assert found
    assert found <= ITALIAN_REMARKS.keys()


def test_numbers_are_written_in_the_languages_way():
    assert Words("en").number(-0.04, 1) == "0.0"
    assert Words("en").number(-12.34, 1) == "\N{MINUS SIGN}12.3"
    assert Words("it").interval([-1.5, 2.25], 2) == "[\N{MINUS SIGN}1,50; 2,25]"
    assert Words("it").date(2026, 3, 1) == "1 marzo 2026"


def test_no_number_or_term_of_the_italian_report_is_english():
    words = Words("it")
    assert (words.short(0.5), words.short(20.0)) == ("0,5", "20")
    assert (words.spread(0.31), words.spread(0.0)) == ("± 0,31 s", "a meno di 0,01 s")
    assert (Words("en").spread(0.31), Words("en").spread(0.0)) == ("± 0.31 s", "within 0.01 s")
    assert words.peak_filter("none, sampled at 104 Hz") == "nessuno, campionato a 104 Hz"
    assert words.peak_filter("CFC60") == "CFC60"
    for curve in CURVES:
        assert words.risk(curve.population) != curve.population
        assert curve.level.startswith("MAIS") or words.risk(curve.level) != curve.level
    load_fonts()
    document = document_from(crash(100.0))
    cells = parts.subject_table(document, heading(document), words, dt.datetime(2026, 3, 1, tzinfo=dt.UTC), 500.0)
    told = " ".join(cell.getPlainText() for row in cells._cellvalues for cell in row)
    assert ": 100,000 s" in told


def test_remarks_say_the_same_in_both_languages():
    assert "non è usato" in ITALIAN_REMARKS["gps_disagrees"]
    assert ITALIAN_REMARKS["lies_differently"].startswith("La scatola")
    for name in ("inertial", "gnss"):
        assert f"{name}_rows_repeated" in ITALIAN_REMARKS


@pytest.mark.parametrize("language", ["en", "it"])
@pytest.mark.parametrize("clock", [*range(1, 13)])
def test_every_direction_has_words(language, clock):
    assert Words(language)(f"where{clock}")


@pytest.mark.parametrize("language", ["en", "it"])
def test_a_crash_fills_three_to_five_pages(language):
    document = document_from(crash(100.0))
    pdf = report_pdf(document, heading(document), language)
    assert 3 <= pages(pdf) <= 5
    assert pdf == report_pdf(document, heading(document), language)


@pytest.mark.parametrize("language", ["en", "it"])
def test_so_does_one_of_which_much_is_to_be_said(language):
    event = crash(100.0)
    told = [Remark(code, "This is said of the event, in a sentence of its own.") for code in list(ITALIAN_REMARKS)[:9]]
    more = [dataclasses.replace(event.second_impacts[0], t0=100.0 + later) for later in (-0.6, 0.9, 2.2)]
    full = dataclasses.replace(
        event,
        quality=tuple(told),
        second_impacts=tuple(more),
        rollover_angle=Estimate(3.1, 2.9, 3.3),
        rebound=Estimate(2.0, 1.5, 2.5),
    )
    document = document_from(full)
    found = [("gap_around", "Data are missing in the ten minutes around the event.")] * 4
    assert 3 <= pages(report_pdf(document, heading(document), language, found)) <= 5


@pytest.mark.parametrize(
    "changes",
    [
        {"trajectory": None, "rest": None, "driver": None},
        {"pdof": None, "impact_speed": None, "injuries": (), "second_impacts": ()},
        {"kind": "rollover", "quality": ()},
        {"delta_v": None, "pulse": None, "kind": "parked_impact"},
    ],
)
def test_what_is_missing_is_not_recorded_and_breaks_nothing(changes):
    document = document_from(dataclasses.replace(crash(100.0), **changes))
    assert 1 <= pages(report_pdf(document, heading(document), "en")) <= 5
    assert edr_csv(document)
    if document["event"]["pulse"] is not None:
        rows = {name: value for name, value, _, _ in number_rows(document["event"], Words("en"))}
        assert rows["THIV (EN 1317-1)"] == "not recorded"


def test_a_manoeuvre_has_a_short_report():
    document = document_from(braking(50.0))
    assert pages(report_pdf(document, heading(document), "it")) <= 2


def test_sentences_tell_the_story():
    document = document_from(crash(100.0))
    told = " ".join(sentences(document, Words("en"), dt.datetime(2026, 3, 1, 12, 2, tzinfo=dt.UTC)))
    for part in (
        "1 March 2026 at 12:02:00.00",
        "ahead on the left (11 o'clock)",
        "32.0 km/h",
        "29.9 to 34.3",
        "11 m from",
    ):
        assert part in told


def test_report_elements_and_replay_together_take_under_two_seconds_of_cpu():
    from server.view3d.recording import record

    rich.reconfigure(quiet=True)
    document = document_from(crash(100.0))

    def all_three() -> None:
        report_pdf(document, heading(document), "en")
        edr_json(document, "0" * 64)
        record(document)

    all_three()  # warm
    began = time.process_time()
    all_three()
    took = time.process_time() - began
    rich.reconfigure(quiet=False)
    print(f"report, elements and replay: {took:.2f} s of CPU")
    assert took < 2.0


def test_the_map_marks_every_blow_in_order_of_time():
    class Said(Canvas):
        words: list[str]

        def drawString(self, x, y, text, *more, **options):
            self.words.append(text)
            super().drawString(x, y, text, *more, **options)

    load_fonts()
    one, two = crash(100.0), dataclasses.replace(crash(100.0), second_impacts=())
    for event, wanted in ((one, {"impact 1", "impact 2"}), (two, {"impact"})):
        table, _ = parts.maps(document_from(event), Words("en"), 500.0)
        for way in table._cellvalues[0]:
            canvas = Said(io.BytesIO())
            canvas.words = []
            way.drawOn(canvas, 0.0, 0.0)
            assert {word for word in canvas.words if word.startswith("impact")} == wanted


def test_the_clock_is_as_good_in_every_row():
    load_fonts()
    document = document_from(crash(100.0))
    spread = Words("en").spread(document["event"]["basis"]["utc_sigma_s"])
    (rows, *_) = parts.provenance_tables(document, "0" * 64, Words("en"), 500.0, 12)
    assert spread in " ".join(cell.getPlainText() for row in rows._cellvalues for cell in row)
    assert spread in sentences(document, Words("en"), dt.datetime(2026, 3, 1, tzinfo=dt.UTC))[0]


@pytest.mark.parametrize("apart", [(0.0, 0.0), (3.0, 2.0), (-12.0, 0.0), (6.0, -4.0), (0.0, 9.0), (30.0, 1.0)])
def test_words_beside_marks_that_are_close_together_do_not_lie_upon_each_other(apart):
    dots = [(100.0, 80.0), (100.0 + apart[0], 80.0 + apart[1]), (101.0, 79.0)]
    taken = [(x - 3.0, y - 3.0, x + 3.0, y + 3.0) for x, y in dots]
    for (x, y), width in zip(dots, (24.0, 16.0, 30.0), strict=True):
        left, bottom, right, top = room_beside(x, y, width, taken)
        assert right - left == pytest.approx(width)
        assert not any(left < r and l < right and bottom < t and b < top for l, b, r, t in taken)
        assert abs(0.5 * (bottom + top) - y) < 45.0
        taken.append((left, bottom, right, top))
