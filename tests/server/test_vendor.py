"""Third-party files are exactly those that the manifest names."""

from __future__ import annotations

import hashlib
import json
from itertools import pairwise

import pytest

from server.resources import folder

VENDOR = folder("web") / "vendor"
MANIFEST = json.loads((VENDOR / "MANIFEST.json").read_text())


@pytest.mark.parametrize("package", MANIFEST, ids=lambda package: package["name"])
def test_files_are_those_of_the_manifest(package):
    assert package["version"]
    assert package["licence"]
    assert any("LICENSE" in file["path"] for file in package["files"])
    for file in package["files"]:
        assert hashlib.sha256((VENDOR / file["path"]).read_bytes()).hexdigest() == file["sha256"], file["path"]


def test_no_file_without_an_entry():
    listed = {file["path"] for package in MANIFEST for file in package["files"]}
    present = {path.relative_to(VENDOR).as_posix() for path in VENDOR.rglob("*") if path.is_file()}
    assert present - {"MANIFEST.json"} == listed


def test_versions_are_those_of_the_development_packages():
    wanted = json.loads((folder("web").parent / "package.json").read_text())["devDependencies"]
    assert {package["name"]: package["version"] for package in MANIFEST}.items() <= wanted.items()


def test_the_outline_is_geojson_on_the_globe():
    land = json.loads((VENDOR / "world-atlas" / "land.geojson").read_text())
    rings = [ring for feature in land["features"] for ring in feature["geometry"]["coordinates"]]
    assert len(rings) > 1000
    for ring in rings:
        assert ring[0] == ring[-1]
        # Beyond ±180 where a country lies across the date line; a jump would draw a line around the world.
        assert all(-540 <= lon <= 540 and -90 <= lat <= 90 for lon, lat in ring)
        jumps = [abs(b[0] - a[0]) for a, b in pairwise(ring) if a[1] != -90 or b[1] != -90]
        assert max(jumps) < 180


def test_own_scripts_stay_small():
    scripts = (folder("web") / "static" / "js").rglob("*.js")
    assert sum(path.stat().st_size for path in scripts) < 60_000
