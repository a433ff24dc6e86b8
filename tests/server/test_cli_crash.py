"""`scatola crash`: the keys of the contract, with and without `--mount`, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from nav_core.records import Drive, Gnss, Inertial
from nav_core.simulate import Impact, Scenario, simulate
from server.cli.files import truth_json
from server.cli.main import main
from server.formats.drive import from_drive, write_drive_file

KEYS = [
    "kind",
    "t0_s",
    "t_end_s",
    "delta_v_kmh",
    "delta_v_interval95_kmh",
    "time_of_max_ms",
    "pdof_deg",
    "pdof_interval95_deg",
    "pdof_clock",
    "impact_speed_kmh",
    "impact_speed_interval95_kmh",
    "peak_g",
    "clipped",
    "clipped_samples",
    "asi",
    "olc_g",
    "thiv_kmh",
    "phd_g",
    "injury",
    "quality",
]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("crash")
    impact = Impact(t=165.0, delta_v=32.0 / 3.6, pdof=-0.12, speed=41.0 / 3.6)
    drive, truth = simulate(Scenario(duration=180.0, accel_rate=100.0, with_gyro=True, impacts=(impact,)), seed=11)
    write_drive_file(folder / "drive.csv", from_drive(drive))
    keep = (drive.inertial.t > 164.9) & (drive.inertial.t < 165.4)
    nothing = Gnss(*[np.zeros(0)] * 6, fix=np.zeros(0, dtype=bool))
    burst = Drive(Inertial(drive.inertial.t[keep], drive.inertial.f[keep]), nothing)
    write_drive_file(folder / "burst.parquet", from_drive(burst))
    (folder / "mount.json").write_text(json.dumps({"R_va": truth.R_va.tolist()}), encoding="utf-8")
    return folder, truth_json(truth, seed=11)["events"][0]


def events_of(capsys, *arguments):
    assert main(["crash", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)["events"]


def test_the_json_has_the_keys_of_the_contract_and_agrees_with_the_truth(recording, capsys):
    folder, truth = recording
    (event,) = [each for each in events_of(capsys, folder / "drive.csv") if each["kind"] == "crash"]
    assert list(event)[: len(KEYS)] == KEYS
    assert event["t0_s"] == pytest.approx(truth["t0_s"], abs=0.03)
    assert event["delta_v_kmh"]["resultant"] == pytest.approx(32.0, rel=0.03)
    for name, value in event["delta_v_kmh"].items():
        low, high = event["delta_v_interval95_kmh"][name]
        assert low <= value <= high
    low, high = event["pdof_interval95_deg"]
    assert low <= truth["pdof_deg"] <= high
    assert event["pdof_clock"] == 12
    low, high = event["impact_speed_interval95_kmh"]
    assert low <= truth["impact_speed_kmh"] <= high
    assert event["injury"]["curve"] == "NHTSA-2022-all"
    assert set(event["injury"]) == {"curve", "p_mais3", "interval95"}
    assert event["thiv_kmh"] is None or event["thiv_kmh"] > 5.0
    assert all(isinstance(code, str) for code in event["quality"])


def test_half_a_second_without_gps_with_a_mounting(recording, capsys):
    folder, _ = recording
    (event,) = events_of(capsys, folder / "burst.parquet", "--mount", folder / "mount.json")
    assert event["delta_v_kmh"]["resultant"] == pytest.approx(32.0, rel=0.03)
    assert event["impact_speed_kmh"] is None
    assert event["impact_speed_interval95_kmh"] is None
    assert event["thiv_kmh"] is None
    assert {"no_gps", "axes_rotating"} <= set(event["quality"])


def test_what_is_said_on_a_terminal(recording, capsys):
    folder, _ = recording
    assert main(["crash", str(folder / "burst.parquet"), "--mount", str(folder / "mount.json")]) == 0
    text = capsys.readouterr().out
    assert "delta-V resultant 3" in text
    assert "12 o'clock" in text
    assert "MAIS3+" in text


def test_a_drive_without_events_says_so(tmp_path, capsys):
    drive, truth = simulate(Scenario(route="gentle", duration=60.0, accel_rate=50.0), seed=1)
    write_drive_file(tmp_path / "calm.csv", from_drive(drive))
    (tmp_path / "mount.json").write_text(json.dumps({"R_va": truth.R_va.tolist()}), encoding="utf-8")
    arguments = ["crash", str(tmp_path / "calm.csv"), "--mount", str(tmp_path / "mount.json")]
    assert main([*arguments, "--vehicle-class", "truck"]) == 0
    assert "no event" in capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"events": []}


def test_bad_mountings_are_refused_with_one_line(recording, tmp_path, capsys):
    folder, _ = recording
    for document, said in (({"R_va": [[1, 0, 0], [0, 2, 0], [0, 0, 1]]}, "not a rotation"), ({"a": 1}, "no R_va")):
        (tmp_path / "bad.json").write_text(json.dumps(document), encoding="utf-8")
        assert main(["crash", str(folder / "burst.parquet"), "--mount", str(tmp_path / "bad.json")]) == 1
        assert said in capsys.readouterr().err
    (tmp_path / "none.json").write_text(json.dumps({"R_va": None, "status": "not_fixed"}), encoding="utf-8")
    (event,) = events_of(capsys, folder / "burst.parquet", "--mount", tmp_path / "none.json")
    assert event["delta_v_kmh"]["longitudinal"] is None
    assert event["delta_v_kmh"]["resultant"] == pytest.approx(32.0, rel=0.03)


EYE = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("document", "named"),
    [
        ([], "R_va"),
        ({"R_va": "sideways"}, "R_va"),
        ({"R_va": [[1.0], [2.0, 3.0]]}, "R_va"),
        ({"R_va": {"x": 1}}, "R_va"),
        ({"R_va": EYE, "sigma_deg": {"x": 1.0, "y": 1.0}}, "sigma_deg.z"),
        ({"R_va": EYE, "sigma_deg": 1.0}, "sigma_deg"),
        ({"R_va": EYE, "sigma_deg": {"x": 1.0, "y": 1.0, "z": None}}, "sigma_deg.z"),
        ({"R_va": EYE, "sigma_deg": {"x": 1.0, "y": 1.0, "z": -1.0}}, "sigma_deg"),
        ({"R_va": EYE, "gps_lag_s": 0.2}, "gps_lag_s"),
        ({"R_va": EYE, "gps_lag_s": {"speed": "late"}}, "gps_lag_s.speed"),
        ({"R_va": EYE, "gps_lag_s": {"course": [0.1]}}, "gps_lag_s.course"),
        ({"R_va": EYE, "changes": 3}, "changes"),
        ({"R_va": EYE, "changes": [3]}, "changes[0].t_s"),
        ({"R_va": EYE, "changes": [{"t_s": 3.0}]}, "changes[0].angle_deg"),
    ],
)
def test_a_mount_that_cannot_be_read_is_named_in_one_line(recording, tmp_path, capsys, document, named):
    folder, _ = recording
    mount = tmp_path / "MOUNT.json"
    mount.write_text(json.dumps(document), encoding="utf-8")
    assert main(["crash", str(folder / "burst.parquet"), "--mount", str(mount)]) == 1
    said = capsys.readouterr().err
    assert named in said
    assert "MOUNT.json" in said
    assert said.count("\n") == 1
