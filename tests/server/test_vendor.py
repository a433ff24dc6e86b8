"""Third-party files are exactly those that the manifest names."""

from __future__ import annotations

import hashlib
import json

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
    (feature,) = land["features"]
    rings = [ring for polygon in feature["geometry"]["coordinates"] for ring in polygon]
    assert len(rings) > 1000
    assert all(ring[0] == ring[-1] for ring in rings)
    assert all(-180 <= lon <= 180 and -90 <= lat <= 90 for ring in rings for lon, lat in ring)
