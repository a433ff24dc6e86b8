"""Archives of evidence that were damaged, byte by byte: all of it is found, none of it ends in a traceback."""

from __future__ import annotations

import io
import json
import zipfile

import pytest
from test_evidence_forgery import archive_of, verdict, world

from server.cli.main import main
from server.evidence.verify import check_zip

__all__ = ["world"]


def flipped(data: bytes, place: int, bit: int = 0) -> bytes:
    return data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :]


def test_a_changed_byte_of_any_file_is_found(world, admin):
    del world
    files = archive_of(admin)
    assert verdict(files).passed
    for name, data in files.items():
        count = 40 if name == "manifest.json" else 3  # which no other file lists
        for k in range(count):
            place = k * (len(data) - 1) // (count - 1)
            if not data[place : place + 1].isspace():
                assert not verdict({**files, name: flipped(data, place)}).passed, (name, place)


@pytest.mark.parametrize(
    ("key", "value"), [("schema", "scatola-evidence-2"), ("event_id", "ab" * 16), ("revision", 7), ("files", {})]
)
def test_every_word_of_the_manifest_counts(world, admin, key, value):
    del world
    files = archive_of(admin)
    manifest = {**json.loads(files["manifest.json"]), key: value}
    assert not verdict({**files, "manifest.json": json.dumps(manifest).encode()}).passed


def test_damage_to_the_zip_itself_is_told_in_one_line(tmp_path, capsys):
    """Flags, versions and methods that no reader has, lengths that cannot be: zipfile raises some ten kinds."""
    small, path = io.BytesIO(), tmp_path / "damaged.zip"
    with zipfile.ZipFile(small, "w", zipfile.ZIP_DEFLATED) as out:
        for name in ("manifest.json", "event.json"):
            out.writestr(name, json.dumps({"files": {"event.json": "x"}}))
    data = small.getvalue()
    for place in range(len(data)):
        for bit in (0, 3, 5):
            path.write_bytes(flipped(data, place, bit))
            assert not check_zip(path).passed
            assert main(["verify", str(path)]) == 1
    for damaged in (data[:-40], b"", b"PK"):
        path.write_bytes(damaged)
        assert main(["verify", str(path)]) == 1
    assert main(["verify", str(tmp_path / "none.zip")]) == 1
    told = capsys.readouterr().err.splitlines()
    assert all(line.startswith("scatola: ") for line in told)
    assert len(told) == 3 * len(data) + 4
