"""`scatola align`: levels at rest, finds north where the sensors can, and says why where they cannot."""

from __future__ import annotations

import json

import numpy as np
import pytest

from nav_core.earth import earth_rate, gravity, magnetic_field
from nav_core.rotation import euler_to_matrix
from server.cli.main import main
from tests.recordings import folder

LAT, LON, HEIGHT, YEAR = 41.1, 16.9, 60.0, 2026.25
UTC = 1_775_044_800.0
ATTITUDE = np.radians([12.0, -7.0, 65.0])
KEYS = {
    "status", "rest", "levelling", "gyrocompass", "magnetic", "heading_from", "R_ta", "euler_deg", "sigma_deg",
    "reasons", "reason_codes",
}  # fmt: skip


def write(path, *, gyro=None, field=True, fixes=True, moving=False, iron=0.0, seconds=60.0, utc=UTC):
    """A box at rest between two stretches of driving; `gyro` is its white noise, rad/s/√Hz, or None for no gyro."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, seconds, 0.02)
    R_ta = euler_to_matrix(*ATTITUDE)
    lat, lon = np.radians([LAT, LON])
    columns = {"t": t}
    f = R_ta.T @ np.array([0.0, 0.0, -float(gravity(lat, HEIGHT))]) + 0.03 * rng.standard_normal((t.size, 3))
    driving = np.ones(t.size, bool) if moving else (t < 10.0) | (t > 50.0)
    f[driving] += 2.0 * rng.standard_normal((int(driving.sum()), 3))
    columns |= dict(zip(("fx", "fy", "fz"), f.T, strict=True))
    if gyro is not None:
        w = R_ta.T @ earth_rate(lat) + gyro * np.sqrt(50.0) * rng.standard_normal((t.size, 3))
        columns |= dict(zip(("wx", "wy", "wz"), w.T, strict=True))
    if field:
        m = R_ta.T @ magnetic_field(lat, lon, HEIGHT, YEAR).vector + 0.3 * rng.standard_normal((t.size, 3)) + iron
        columns |= dict(zip(("mx", "my", "mz"), m.T, strict=True))
    if fixes:
        columns |= {"lat": np.full(t.size, LAT), "lon": np.full(t.size, LON), "alt": np.full(t.size, HEIGHT)}
        columns |= {"speed": np.zeros(t.size), "course": np.zeros(t.size), "fix": np.ones(t.size)}
        columns |= {"utc": utc + t}
    np.savetxt(
        path, np.column_stack(list(columns.values())), fmt="%.17g", delimiter=",", header=",".join(columns), comments=""
    )
    return path


def run(capsys, *arguments):
    status = main(["align", *[str(argument) for argument in arguments]])
    printed = capsys.readouterr()
    assert status == 0, printed.err
    return printed.out


def aligned(capsys, *arguments):
    result = json.loads(run(capsys, *arguments, "--json"))
    assert set(result) == KEYS
    return result


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Consumer sensors with a calibrated magnetometer."""
    return write(tmp_path_factory.mktemp("align") / "plain.csv", gyro=np.radians(8e-3))


def test_a_consumer_box_is_levelled_and_turned_by_its_magnetometer(capsys, plain):
    result = aligned(capsys, plain)
    assert result["status"] == "aligned"
    assert result["heading_from"] == "magnetic"
    assert 9.5 < result["rest"]["from_s"] < 11.5
    assert 48.5 < result["rest"]["to_s"] < 50.5
    roll, pitch, yaw = np.degrees(ATTITUDE)
    level, sigma = result["levelling"], result["sigma_deg"]
    assert level["roll_deg"] == pytest.approx(roll, abs=0.05)
    assert level["pitch_deg"] == pytest.approx(pitch, abs=0.05)
    assert level["sigma_deg"] == pytest.approx(np.degrees(5.0e-3), rel=0.05)
    assert result["euler_deg"]["yaw"] == pytest.approx(yaw, abs=0.5)
    assert 1.0 < sigma["down"] < 4.0
    assert np.array(result["R_ta"]) == pytest.approx(euler_to_matrix(*ATTITUDE), abs=0.01)
    assert result["magnetic"]["plausible"]


def test_its_gyros_do_not_find_north_and_the_numbers_say_why(capsys, plain):
    compass = aligned(capsys, plain)["gyrocompass"]
    assert compass["status"] == "unobservable"
    assert compass["yaw_deg"] is None
    assert compass["earth_rate_north_dph"] == pytest.approx(11.33, abs=0.01)
    assert compass["sigma_rate_dph"] == pytest.approx(360.0, rel=0.02)
    assert compass["needed_rate_dph"] < 1.0
    assert compass["sigma_yaw_deg"] > 1000.0


def test_navigation_gyros_find_north(capsys, tmp_path):
    file = write(tmp_path / "navigation.csv", gyro=np.radians(1e-6), field=False)
    result = aligned(capsys, file, "--gyro-bias-deg-per-hour", 0.01, "--accel-bias-mg", 0.05)
    assert result["heading_from"] == "gyrocompass"
    assert result["gyrocompass"]["status"] == "observable"
    assert result["euler_deg"]["yaw"] == pytest.approx(65.0, abs=4.0 * result["sigma_deg"]["down"])
    assert result["sigma_deg"]["down"] < 0.5
    assert result["reason_codes"] == ["no_magnetometer"]


def test_iron_in_the_field_is_noticed(capsys, tmp_path):
    result = aligned(capsys, write(tmp_path / "iron.csv", iron=np.array([15.0, -10.0, 5.0])))
    assert result["status"] == "levelled"
    assert result["euler_deg"] is None
    assert not result["magnetic"]["plausible"]
    assert result["reason_codes"] == ["no_gyro", "field_disturbed"]
    assert result["gyrocompass"] is None


def test_without_fixes_the_place_comes_from_the_options(capsys, tmp_path):
    file = write(tmp_path / "bare.csv", gyro=1e-4, fixes=False)
    bare = aligned(capsys, file)
    assert bare["reason_codes"] == ["no_place", "no_field_model"]
    assert bare["levelling"]["roll_deg"] == pytest.approx(12.0, abs=0.05)
    told = aligned(capsys, file, "--lat", LAT, "--lon", LON, "--height", HEIGHT, "--year", YEAR)
    assert told["heading_from"] == "magnetic"
    assert told["euler_deg"]["yaw"] == pytest.approx(65.0, abs=0.5)


def test_a_receiver_that_does_not_know_the_date_only_costs_the_field(capsys, tmp_path):
    result = aligned(capsys, write(tmp_path / "undated.csv", gyro=1e-4, utc=315_964_800.0))
    assert result["status"] == "levelled"
    assert "no_field_model" in result["reason_codes"]


def test_a_heading_worse_than_wanted_is_not_given(capsys, plain):
    result = aligned(capsys, plain, "--heading-limit-deg", 0.5)
    assert result["status"] == "levelled"
    assert result["R_ta"] is None
    assert "field_steep" in result["reason_codes"]


def test_a_box_that_never_rests_has_no_attitude(capsys, tmp_path):
    result = aligned(capsys, write(tmp_path / "moving.csv", moving=True))
    assert result["status"] == "insufficient"
    assert result["reason_codes"] == ["no_rest"]
    assert result["rest"] is None
    assert result["levelling"] is None


def test_people_read_lines(capsys, plain, tmp_path):
    text = run(capsys, plain)
    assert text.startswith("aligned\n  at rest from 1")
    assert "by the Earth's turning: unobservable" in text
    assert "(magnetic)" in text
    assert run(capsys, write(tmp_path / "moving.csv", moving=True)).startswith("insufficient\n  - The specific force")


def test_the_figure_is_written(capsys, plain, tmp_path):
    for number, file in enumerate((plain, write(tmp_path / "moving.csv", moving=True, field=False))):
        image = tmp_path / f"figure{number}.png"
        run(capsys, file, "--plot", image)
        assert image.read_bytes().startswith(b"\x89PNG")
        assert image.stat().st_size > 10_000


def test_bad_data_is_one_clear_line(capsys, tmp_path):
    short = tmp_path / "short.csv"
    short.write_text("t,fx,fy,fz\n0,0,0,-9.8\n0.1,0,0,-9.8\n", encoding="utf-8")
    assert main(["align", str(short)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    in_g = write(tmp_path / "g.csv", field=False)
    values = np.genfromtxt(in_g, delimiter=",", names=True)
    lines = "\n".join(f"{row['t']},{row['fx'] / 9.8},{row['fy'] / 9.8},{row['fz'] / 9.8}" for row in values)
    in_g.write_text("t,fx,fy,fz\n" + lines, encoding="utf-8")
    assert main(["align", str(in_g)]) == 1
    assert "specific force is 1" in capsys.readouterr().err


def test_a_real_consumer_sensor_at_rest(capsys, tmp_path):
    """An MPU-6050 on a table for eleven minutes: levelled; north is out of its reach, and claiming otherwise shows."""
    base = folder("sunsided-mpu6050-hmc5883l")
    name = "unmoved-with-x-pointing-forward-10min__mpu6050_{}.csv.gz"
    accel, gyro = (
        np.genfromtxt(base / name.format(sensor), delimiter=",", skip_header=1)[:, 1:4]
        for sensor in ("accelerometer", "gyroscope")
    )
    count = min(len(accel), len(gyro))
    # The host stamped in bursts what the sensor sampled evenly, and logged the negative of the specific force.
    rows = np.column_stack([np.arange(count) / 99.32, -9.80665 * accel[:count], np.radians(gyro[:count])])
    file = tmp_path / "table.csv"
    np.savetxt(file, rows, delimiter=",", header="t,fx,fy,fz,wx,wy,wz", comments="")
    result = aligned(capsys, file, "--lat", 50.0)
    assert result["status"] == "levelled"
    assert result["rest"]["to_s"] - result["rest"]["from_s"] > 60.0
    # Its z axis points up.
    assert result["levelling"]["roll_deg"] == pytest.approx(176.4, abs=0.3)
    assert result["levelling"]["pitch_deg"] == pytest.approx(-2.3, abs=0.3)
    assert result["gyrocompass"]["status"] == "unobservable"
    claimed = aligned(capsys, file, "--lat", 50.0, "--gyro-bias-deg-per-hour", 0.01, "--heading-limit-deg", 60.0)
    assert claimed["gyrocompass"]["status"] == "disturbed"
    assert claimed["euler_deg"] is None


def by_hand(capsys, *arguments):
    result = json.loads(run(capsys, *arguments, "--by-hand", "--json"))
    assert set(result) == {
        "status", "rest", "tolerance_g", "largest_tilt_deg", "upright", "orientations", "R_va", "reasons",
    }  # fmt: skip
    return result


def test_by_hand_the_upright_axis_and_four_orientations_remain(capsys, plain):
    """The box of `write` leans by 14°: upright enough at 5 % of g, not at 1 %."""
    result = by_hand(capsys, plain)
    assert result["status"] == "level"
    assert result["largest_tilt_deg"] == pytest.approx(18.19, abs=0.005)
    upright = result["upright"]
    # Levelled, z points down, so that its reading at rest is negative.
    assert (upright["axis"], upright["points"]) == ("z", "down")
    tilt = np.arccos(np.cos(ATTITUDE[0]) * np.cos(ATTITUDE[1]))
    assert upright["angle_deg"] == pytest.approx(np.degrees(tilt), abs=0.1)
    assert upright["reading_g"] == pytest.approx(np.cos(tilt), abs=0.002)
    assert upright["cross_error_g"] == pytest.approx(np.sin(tilt), abs=0.002)
    assert [each["forward"] for each in result["orientations"]] == ["+x", "-y", "-x", "+y"]
    assert result["R_va"] is None
    chosen = by_hand(capsys, plain, "--forward-axis=+x")
    assert chosen["R_va"] == np.eye(3).tolist()
    assert chosen["orientations"][0]["euler_deg"] == {"theta": 0.0, "phi": 0.0, "psi": 0.0}

    strict = by_hand(capsys, plain, "--tolerance", 0.01, "--forward-axis=+x")
    assert strict["status"] == "not_level"
    assert strict["R_va"] is None
    assert "z reads 0.97" in strict["reasons"][0]


def test_by_hand_says_what_it_cannot_do(capsys, plain, tmp_path):
    assert main(["align", str(plain), "--by-hand", "--forward-axis=-z"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["align", str(plain), "--by-hand", "--tolerance", "2"]) == 1
    assert "tolerance" in capsys.readouterr().err
    moving = by_hand(capsys, write(tmp_path / "moving.csv", moving=True))
    assert moving["status"] == "insufficient"
    assert moving["orientations"] is None
    text = run(capsys, plain, "--by-hand")
    assert text.startswith("level\n  at rest from 1")
    assert "  1. +x forward: theta 0°, phi 0°, psi 0°\n" in text
    figure = tmp_path / "by-hand.png"
    text = run(capsys, plain, "--by-hand", "--forward-axis=-x", "--plot", figure)
    assert "-x forward" in next(line for line in text.splitlines() if line.endswith("<- chosen"))
    assert figure.stat().st_size > 10_000
