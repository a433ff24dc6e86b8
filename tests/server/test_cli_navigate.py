"""`scatola navigate`: the columns of the contract, outages, figures, boxes without a gyro, and what is refused."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from nav_core.navigation import hidden
from nav_core.records import Drive, Inertial
from nav_core.simulate import Scenario, simulate
from server.cli.main import main
from server.formats.drive import from_drive, read_drive_file, write_drive_file

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


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ("{", "is no JSON"),
        ('{"R_va": [[0, 0, 0], [0, 0, 0], [0, 0, 0]]}', "R_va is not a rotation"),
        ('{"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "sigma_deg": {"x": null, "y": 1, "z": 1}}', "sigma_deg.x"),
        ('{"R_va": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "gps_lag_s": [1]}', "gps_lag_s is not an object"),
    ],
)
def test_a_mounting_that_is_none_is_one_line_that_names_the_file(recording, tmp_path, capsys, document, said):
    folder, _ = recording
    mount = tmp_path / "MOUNT.json"
    mount.write_text(document, encoding="utf-8")
    arguments = ["navigate", str(folder / "drive.csv"), "--out", str(tmp_path / "track.csv")]
    assert main([*arguments, "--mount", str(mount)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert "MOUNT.json" in error


def test_what_a_reader_of_the_track_must_know_is_remarked(recording, tmp_path, capsys):
    """A mounting that still settles, a start at rest, and no height: the column stays empty."""
    folder, truth = recording
    mount = tmp_path / "settling.json"
    sigma = {"x": 0.5, "y": 0.5, "z": 3.0}
    mount.write_text(json.dumps({"R_va": truth.R_va.tolist(), "status": "settling", "sigma_deg": sigma}), "utf-8")
    drive = read_drive_file(folder / "drive.csv")
    low = tmp_path / "low.csv"
    write_drive_file(low, from_drive(replace(drive, gnss=replace(drive.gnss, alt=np.full(drive.gnss.t.size, np.nan)))))
    out = tmp_path / "track.csv"
    assert main(["navigate", str(low), "--out", str(out), "--mount", str(mount), "--json"]) == 0
    quality = " ".join(json.loads(capsys.readouterr().out)["quality"])
    assert "still settling: known to ±3.0°" in quality
    assert "begins with the first moving fix" in quality
    header, values = track(out)
    assert np.isnan(values[:, [header.index("alt"), header.index("alt_sigma")]]).all()
    assert np.isfinite(values[:, header.index("vd_sigma")]).all()


def test_fixes_without_speed_are_named(recording, tmp_path, capsys):
    folder, _ = recording
    drive = read_drive_file(folder / "drive.csv")
    nothing = np.full(drive.gnss.t.size, np.nan)
    bare = tmp_path / "bare.csv"
    write_drive_file(bare, from_drive(replace(drive, gnss=replace(drive.gnss, speed=nothing, course=nothing))))
    assert main(["navigate", str(bare), "--out", str(tmp_path / "track.csv")]) == 1
    assert "no speed and course" in capsys.readouterr().err


def test_pulses_date_the_track_and_tell_how_late_fixes_arrive(recording, tmp_path, capsys):
    """The box clock runs 30 ppm fast of UTC's second; the receiver answers 0.27 s after the moment of its fix."""
    folder, truth = recording
    drive = read_drive_file(folder / "drive.csv")
    gnss, latency, begin = drive.gnss, 0.27, 1_767_225_600.4
    utc = begin + (1.0 - 3e-5) * (gnss.t - latency)
    file = tmp_path / "dated.csv"
    write_drive_file(file, from_drive(Drive(drive.inertial, replace(gnss, utc=utc))))
    seconds = np.arange(np.ceil(begin), begin + 100.0)
    pulses = tmp_path / "pulses.csv"
    np.savetxt(pulses, (seconds - begin) / (1.0 - 3e-5), header="t", comments="", fmt="%.6f")
    mount = tmp_path / "mount.json"
    mount.write_text(json.dumps({"R_va": truth.R_va.tolist()}), encoding="utf-8")
    arguments = ["navigate", str(file), "--out", str(tmp_path / "track.csv"), "--mount", str(mount)]

    assert main([*arguments, "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["clock"]["source"] == "fixes"
    assert plain["clock"]["fix_latency_s"] is None
    assert plain["gps_lag_s"] == {"speed": 0.0, "course": 0.0}

    assert main([*arguments, "--json", "--pulses", str(pulses)]) == 0
    report = json.loads(capsys.readouterr().out)
    clock = report["clock"]
    assert clock["source"] == "pulses"
    assert clock["fix_latency_s"] == pytest.approx(latency, abs=1e-3)
    assert clock["drift_ppm"] == pytest.approx(-30.0, abs=1.0)
    assert clock["utc_at_begin"] == pytest.approx(begin + (1.0 - 3e-5) * report["begin_s"], abs=2e-5)
    assert clock["sigma_s"] < 1e-3
    assert report["gps_lag_s"]["speed"] == clock["fix_latency_s"]
    # The fixes alone date everything too early by their latency, and cannot know it.
    dated = begin - latency + (1.0 - 3e-5) * plain["begin_s"]
    assert plain["clock"]["utc_at_begin"] == pytest.approx(dated, abs=1e-3)

    assert main([*arguments, "--pulses", str(pulses)]) == 0
    assert "dated by the pulses" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("s\n1\n", "column t"),
        ("t\n1\nx\n", "column t of numbers"),
        ("t\n1\nnan\n", "row 3"),
        ("t\n900000\n", "same box clock"),
    ],
)
def test_pulses_that_cannot_be_used_are_one_line(recording, tmp_path, capsys, rows, said):
    folder, _ = recording
    pulses = tmp_path / "pulses.csv"
    pulses.write_text(rows, encoding="utf-8")
    arguments = ["navigate", str(folder / "drive.csv"), "--out", str(tmp_path / "track.csv")]
    assert main([*arguments, "--mount", str(folder / "mount.json"), "--pulses", str(pulses)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
