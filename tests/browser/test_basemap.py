"""The operator's own map: an archive of tiles beside the service is drawn, and no other host is asked."""

from __future__ import annotations

import io
import json
import struct

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser.test_pages import count_near, css, pixels, wait_drawn

PICTURE, SHAPES = 2, 1


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def field(number: int, content: bytes | int) -> bytes:
    """A field of a protocol buffer: a number or bytes."""
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    return varint(number << 3 | 2) + varint(len(content)) + content


def water_everywhere() -> bytes:
    """A vector tile with one polygon over all of it, in the layer that the Protomaps schema calls water."""
    extent = 4096
    steps = [(0, 0), (extent, 0), (0, extent), (-extent, 0)]
    turns = [varint(value << 1 ^ value >> 31) for step in steps for value in step]
    move, line, close = (varint(count << 3 | command) for command, count in ((1, 1), (2, 3), (7, 1)))
    geometry = b"".join([move, *turns[:2], line, *turns[2:], close])
    layer = field(1, b"water") + field(2, field(3, 3) + field(4, geometry)) + field(5, extent) + field(15, 2)
    return field(3, layer)


def magenta() -> bytes:
    sink = io.BytesIO()
    Image.new("RGB", (256, 256), "#ff00ff").save(sink, "PNG")
    return sink.getvalue()


def archive(tile: bytes, kind: int) -> bytes:
    """PMTiles version 3 with the one tile of zoom 0, nothing compressed."""
    directory = b"".join(map(varint, (1, 0, 1, len(tile), 1)))  # one entry: id, run, length, offset + 1
    about = json.dumps({"vector_layers": [{"id": "water", "fields": {}}]} if kind == SHAPES else {}).encode()
    root, metadata = 127, 127 + len(directory)
    data = metadata + len(about)
    places = (root, len(directory), metadata, len(about), data, 0, data, len(tile), 1, 1, 1)
    world = (-1_800_000_000, -850_000_000, 1_800_000_000, 850_000_000)
    head = b"PMTiles\x03" + struct.pack("<11Q6B4iB2i", *places, 1, 1, 1, kind, 0, 0, *world, 0, 0, 0)
    assert len(head) == root
    return head + directory + about + tile


@pytest.mark.parametrize(("kind", "tile"), [(PICTURE, magenta), (SHAPES, water_everywhere)], ids=["pictures", "shapes"])
def test_the_operators_tiles_are_drawn(site, open_page, settings, tmp_path, screenshot, kind, tile):
    path = tmp_path / "town.pmtiles"
    path.write_bytes(archive(tile(), kind))
    site.app.state.settings = settings.model_copy(update={"map_pmtiles": str(path)})
    page = open_page("/")
    fleet_map = page.locator("fleet-map")
    expect(fleet_map).to_have_attribute("data-marks", "5")
    whole = pixels(fleet_map)[..., 0].size
    wait_drawn(fleet_map, "#ff00ff" if kind == PICTURE else css(page, "sea"), round(0.7 * whole))
    assert count_near(pixels(fleet_map), css(page, "land"), 6) < 0.05 * whole
    # The boxes stand upon it.
    wait_drawn(fleet_map, css(page, "alarm-fill"), 80)
    screenshot(page, f"fleet-pmtiles-{kind}")
