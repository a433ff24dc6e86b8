"""`scatola navigate`: the columns of the contract, outages, figures, boxes without a gyro, and what is refused."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from nav_core.navigation import hidden
from nav_core.records import Drive, Inertial
from nav_core.simulate import Scenario, simulate
from server.cli.main import main
from server.formats.drive import from_drive, write_drive_file

VALUES = ["lat", "lon", "alt", "vn", "ve", "vd", "roll", "pitch", "yaw"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A drive of a box with gyro, 20 s of it without GPS, and its mounting."""
    folder = tmp_path_factory.mktemp("navigate")
    drive, truth = simulate(Scenario(duration=100.0, accel_rate=50.0, with_gyro=True), seed=5)
    drive = Drive(drive.inertial, hidden(drive.gnss, 60.0, 80.0))
    write_drive_file(folder / "drive.csv", from_drive(drive))
    still = Drive(Inertial(t=drive.inertial.t, f=drive.inertial.f), drive.gnss)
    write_drive_file(folder / "no-gyro.parquet", from_drive(still))
    mount = {
        "R_va": truth.R_va.tolist(),
        "sigma_deg": {"x": 0.2, "y": 0.2, "z": 0.2},
        "gps_lag_s": {"speed": truth.speed_lag, "course": None},
    }
    (folder / "mount.json").write_text(json.dumps(mount), encoding="utf-8")
    return folder, truth


def track(path):
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    return rows[0], np.array([[float(cell) if cell else np.nan for cell in row] for row in rows[1:]])


def test_the_track_has_the_columns_of_the_contract(recording, capsys):
    folder, truth = recording
    out, figure = folder / "track.csv", folder / "track.png"
    arguments = ["navigate", str(folder / "drive.csv"), "--out", str(out), "--mount", str(folder / "mount.json")]
    assert main([*arguments, "--plot", str(figure), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    header, values = track(out)
    assert header == ["t", *VALUES, *(f"{name}_sigma" for name in VALUES)]
    assert np.isfinite(values).all()
    assert (np.diff(values[:, 0]) > 0.0).all()
    speed = np.hypot(values[:, 4], values[:, 5])
    assert speed == pytest.approx(np.interp(values[:, 0], truth.t, truth.v), abs=1.5)
    assert np.degrees(np.abs(values[:, 7:9])).max() < 12.0
    assert report["method"] == "inertial-gnss"
    (span,) = report["outages"]
    assert span["duration_s"] == pytest.approx(20.0, abs=0.6)
    assert 0.5 < span["radius95_m"] < 15.0
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_forward_only_is_less_sure_and_parquet_is_written(recording, capsys):
    folder, _ = recording
    arguments = ["navigate", str(folder / "drive.csv"), "--mount", str(folder / "mount.json"), "--json"]
    reach = []
    for more in ([], ["--forward"]):
        assert main([*arguments, "--out", str(folder / "track.parquet"), *more]) == 0
        reach.append(json.loads(capsys.readouterr().out)["outages"][0]["radius95_m"])
    assert reach[1] > reach[0]
    assert (folder / "track.parquet").read_bytes().startswith(b"PAR1")


def test_without_a_gyro_it_says_what_it_does(recording, capsys):
    folder, _ = recording
    out = folder / "plain.csv"
    arguments = ["navigate", str(folder / "no-gyro.parquet"), "--out", str(out), "--mount", str(folder / "mount.json")]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "position-velocity" in printed
    assert "No gyro" in printed
    assert "no GPS from" in printed
    header, values = track(out)
    assert np.isnan(values[:, header.index("roll")]).all()
    assert np.isfinite(values[:, header.index("vn_sigma")]).all()


def test_a_mounting_that_is_not_known_is_refused(recording, capsys):
    folder, _ = recording
    (folder / "unknown.json").write_text('{"R_va": null, "reasons": ["No turns yet."]}', encoding="utf-8")
    arguments = ["navigate", str(folder / "drive.csv"), "--out", str(folder / "x.csv")]
    assert main([*arguments, "--mount", str(folder / "unknown.json")]) == 1
    assert "No turns yet." in capsys.readouterr().err
    assert not (folder / "x.csv").exists()
