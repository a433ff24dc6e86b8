"""`scatola allan` and `scatola calibrate`: JSON, words, figures, and one clear line for bad data."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nav_core.sensors import (
    MPU6050_GYRO,
    eighteen_directions,
    reference_rates,
    reference_vectors,
    simulate_noise,
)
from server.cli.main import main
from server.formats.columns import Columns
from server.formats.drive import write_drive_file

G = 9.80665


def run(capsys, *arguments):
    status = main([str(argument) for argument in arguments])
    return status, capsys.readouterr()


def write(path, t, sensor, values, **others):
    columns = {"t": t, **{f"{sensor}{axis}": values[:, i] for i, axis in enumerate("xyz")}, **others}
    write_drive_file(path, Columns(columns))
    return path


def failed(capsys, *arguments):
    status, printed = run(capsys, *arguments)
    assert status == 1
    assert printed.out == ""
    assert printed.err.startswith("scatola: ")
    assert printed.err.count("\n") == 1
    return printed.err


def triad(count, rng, rate=100.0):
    return np.column_stack([simulate_noise(c, count, rate, rng) for c in MPU6050_GYRO])


def dwells(directions, rng, noise, seconds=3.0, rate=100.0):
    """Poses held for some seconds, with a second of handling between them; times and input directions."""
    hold, move = round(seconds * rate), round(rate)
    parts, moving = [], []
    for direction in directions:
        parts += [np.tile(direction, (hold, 1)), np.tile(direction, (move, 1))]
        moving += [np.zeros(hold), np.ones(move)]
    values, shaken = np.vstack(parts), np.concatenate(moving)
    t = np.arange(len(values)) / rate
    return t, values + shaken[:, None] * np.sin(60.0 * t)[:, None] * 0.3, noise * rng.standard_normal(values.shape)


@pytest.fixture(scope="module")
def resting_gyro(tmp_path_factory):
    rng = np.random.default_rng(1)
    path = tmp_path_factory.mktemp("rest") / "gyro.parquet"
    return write(path, np.arange(60_000) / 100.0, "w", triad(60_000, rng))


def test_allan_prints_coefficients_with_intervals(capsys, resting_gyro):
    status, printed = run(capsys, "allan", resting_gyro, "--json")
    result = json.loads(printed.out)
    assert status == 0
    assert set(result) == {"file", "terms", "columns", "quality"}
    assert set(result["columns"]) == {"wx", "wy", "wz"}
    for name, truth in zip(("wx", "wy", "wz"), MPU6050_GYRO, strict=True):
        column = result["columns"][name]
        assert column["N"]["value"] == pytest.approx(truth.N, rel=0.03)
        assert column["N"]["interval95"][0] < column["N"]["value"] < column["N"]["interval95"][1]
        assert column["N"]["unit"] == "rad/s/√Hz"
        assert column["Q"] == {"value": None, "interval95": None, "unit": "rad/s·s"}
        assert column["rate_hz"] == pytest.approx(100.0)
        assert column["likelihood"] > 1e-4
        assert len(column["tau_s"]) == len(column["sigma"]) == len(column["sigma_low95"]) == len(column["freedom"])
    assert result["quality"] == []


def test_allan_in_words_and_as_a_figure(capsys, resting_gyro, tmp_path):
    figure = tmp_path / "allan.png"
    status, printed = run(capsys, "allan", resting_gyro, "--plot", figure, "--terms", "nbkq")
    assert status == 0
    assert "wx: 60000 samples at 100 Hz" in printed.out
    assert "Q = " in printed.out
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert figure.stat().st_size > 10_000


def test_allan_uses_the_longest_stretch_or_the_rate_it_is_told(capsys, tmp_path):
    rng = np.random.default_rng(2)
    t = np.concatenate((np.arange(1000), 5000 + np.arange(4000))) / 100.0
    path = write(tmp_path / "gap.csv", t, "f", rng.standard_normal((5000, 3)))
    result = json.loads(run(capsys, "allan", path, "--json")[1].out)
    assert result["columns"]["fx"]["samples"] == 4000
    assert "--rate" in result["quality"][0]
    told = json.loads(run(capsys, "allan", path, "--json", "--rate", 100)[1].out)
    assert told["columns"]["fx"]["samples"] == 5000


def test_allan_remarks_filtered_samples(capsys, tmp_path):
    rng = np.random.default_rng(9)
    white = rng.standard_normal((20_020, 3))
    smooth = np.column_stack([np.convolve(column, np.full(21, 1.0 / 21.0), "valid") for column in white.T])
    path = write(tmp_path / "smooth.parquet", np.arange(len(smooth)) / 100.0, "w", smooth)
    assert "--shortest" in json.loads(run(capsys, "allan", path, "--json")[1].out)["quality"][0]
    result = json.loads(run(capsys, "allan", path, "--shortest", 2, "--json")[1].out)
    assert result["quality"] == []
    assert result["columns"]["wx"]["N"]["value"] == pytest.approx(0.1, rel=0.1)


def test_an_axis_that_does_not_change_is_left_out_with_a_remark(capsys, tmp_path):
    values = np.random.default_rng(10).standard_normal((1000, 3))
    values[:, 0] = 0.25
    path, figure = write(tmp_path / "dead.csv", np.arange(1000) / 100.0, "f", values), tmp_path / "dead.png"
    result = json.loads(run(capsys, "allan", path, "--json", "--plot", figure)[1].out)
    assert set(result["columns"]) == {"fy", "fz"}
    assert result["quality"] == ["fx repeats itself: all means over 1 samples are alike"]
    assert figure.stat().st_size > 10_000
    still = write(tmp_path / "still.csv", np.arange(1000) / 100.0, "f", np.ones((1000, 3)))
    assert "fz repeats itself" in failed(capsys, "allan", still)


def test_repeated_and_unordered_rows_are_remarked_and_with_a_rate_all_are_taken(capsys, tmp_path):
    t = np.arange(1000) / 100.0
    t[[500, 501]] = t[[501, 500]]
    t[700] = t[699]
    path = write(tmp_path / "stamps.csv", t, "w", np.random.default_rng(11).standard_normal((1000, 3)))
    result = json.loads(run(capsys, "allan", path, "--json")[1].out)
    assert result["columns"]["wx"]["samples"] == 999
    assert [line.split(" ")[1] for line in result["quality"]] == ["1", "1"]
    told = json.loads(run(capsys, "allan", path, "--json", "--rate", 100)[1].out)
    assert told["columns"]["wx"]["samples"] == 1000
    rest = json.loads(run(capsys, "calibrate", "gyro", write(path, t, "w", np.zeros((1000, 3))), "--json")[1].out)
    assert "gyro: 1 of 1000 rows repeated a time and were dropped." in rest["quality"]


def test_progress_is_for_terminals(monkeypatch, capsys):
    from server.cli.progress import progress

    progress("nothing")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    progress("wx: 100 samples")
    assert "wx: 100 samples" in capsys.readouterr().err


def test_allan_refuses_what_has_no_samples(capsys, tmp_path):
    path = tmp_path / "gps.csv"
    path.write_text("t,lat,lon,alt,speed,course,fix\n0,45,9,100,1,90,1\n", encoding="utf-8")
    assert "none of the columns" in failed(capsys, "allan", path)
    short = write(tmp_path / "short.csv", np.arange(2.0), "f", np.zeros((2, 3)))
    assert "too few" in failed(capsys, "allan", short)
    sparse = write(tmp_path / "sparse.csv", np.array([0.0, 1.0, 1.1, 9.0, 9.1]), "f", np.zeros((5, 3)))
    assert "no more than 3 of 5 samples without a gap" in failed(capsys, "allan", sparse)
    assert "--rate" in failed(capsys, "allan", sparse)
    some = write(tmp_path / "some.csv", np.arange(50.0), "f", np.ones((50, 3)))
    assert "at least 256" in failed(capsys, "allan", some)
    assert "terms" in failed(capsys, "allan", some, "--terms", "X")


def test_calibrate_an_accelerometer_from_its_stillness(capsys, tmp_path):
    rng = np.random.default_rng(3)
    turned = eighteen_directions() @ Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix()
    t, truth, noise = dwells(turned, rng, 0.02)
    gain, bias = np.diag([1.01, 0.99, 1.02]), np.array([0.1, -0.2, 0.3])
    path = write(tmp_path / "poses.csv", t, "f", G * truth @ gain + bias + noise)
    figure = tmp_path / "poses.svg"
    status, printed = run(capsys, "calibrate", "accel", path, "--json", "--plot", figure)
    result = json.loads(printed.out)
    assert status == 0
    assert result["method"] == "positions"
    assert [entry["name"] for entry in result["parameters"]][:3] == ["b_x", "b_y", "b_z"]
    np.testing.assert_allclose(result["bias"], bias, atol=0.01)
    np.testing.assert_allclose(result["gain"], gain, atol=1e-3)
    assert result["poses"]["count"] == 18
    assert result["poses"]["enough"] is True
    assert result["rms_after"] < 0.01 < result["rms_before"]
    assert result["turn_on_bias"] is result["temperature"] is result["field_ut"] is None
    assert "Calibration of the accel" in figure.read_text(encoding="utf-8")


def test_calibrate_from_a_row_a_pose_and_the_local_gravity(capsys, tmp_path):
    path = write(tmp_path / "rows.csv", np.arange(18.0), "f", 9.79 * eighteen_directions())
    status, printed = run(capsys, "calibrate", "accel", path, "--poses", "--gravity", 9.79)
    assert status == 0
    assert "s_x" in printed.out
    assert "rms after" in printed.out


def test_too_few_and_coplanar_poses_are_one_clear_line(capsys, tmp_path):
    few = write(tmp_path / "few.csv", np.arange(6.0), "f", G * eighteen_directions()[:6])
    assert "6 poses do not suffice: 9 are needed" in failed(capsys, "calibrate", "accel", few, "--poses")
    angle = np.linspace(0.0, 6.0, 12)
    flat = G * np.column_stack((np.cos(angle), np.sin(angle), 0.0 * angle))
    path = write(tmp_path / "flat.csv", np.arange(12.0), "f", flat)
    assert "coplanar" in failed(capsys, "calibrate", "accel", path, "--poses", "--json")


def test_calibrate_a_gyro_on_a_turntable(capsys, tmp_path):
    rng = np.random.default_rng(4)
    u = eighteen_directions() @ Rotation.from_rotvec([0.5, 0.1, 0.2]).as_matrix()
    speeds = np.radians(np.tile([200.0, 270.0], 9))
    t, rates, noise = dwells(np.vstack((speeds[:, None] * u, [[1.0, 0.0, 0.0]])), rng, np.radians(0.1))
    scale, bias = np.array([1.005, 1.004, 1.009]), np.radians([0.38, 0.20, 0.63])
    path = write(tmp_path / "table.csv", t, "w", rates * scale + bias + noise)
    status, printed = run(capsys, "calibrate", "gyro", path, "--speeds", "200,270", "--json")
    result = json.loads(printed.out)
    assert status == 0
    assert result["method"] == "turntable"
    assert result["poses"]["count"] == 18
    np.testing.assert_allclose(np.diag(result["gain"]), scale, atol=5e-4)
    np.testing.assert_allclose(result["bias"], bias, atol=np.radians(0.05))
    assert "none of the given rates" in result["quality"][0]


def test_calibrate_a_resting_gyro_gives_its_bias_and_the_line_against_temperature(capsys, tmp_path):
    rng = np.random.default_rng(5)
    t = np.arange(60_000) / 100.0
    temp = 20.0 + 20.0 * t / t[-1]
    slope = np.radians([4.339e-3, 2.039e-2, -5.197e-4])
    values = triad(t.size, rng) + np.outer(temp, slope) + np.radians([0.934, 3.216, 0.153])
    path = write(tmp_path / "warm.parquet", t, "w", values, temp=temp)
    status, printed = run(capsys, "calibrate", "gyro", path, "--json")
    result = json.loads(printed.out)
    assert status == 0
    assert result["method"] == "rest"
    assert result["parameters"] is None
    np.testing.assert_allclose(result["turn_on_bias"]["bias"], values[:200].mean(axis=0))
    np.testing.assert_allclose(result["temperature"]["slope_per_k"], slope, atol=np.radians(5e-4))
    figure = tmp_path / "warm.svg"
    words = run(capsys, "calibrate", "gyro", path, "--plot", figure)[1].out
    assert "turn-on bias" in words
    assert "per K" in words
    assert "temperature" in figure.read_text(encoding="utf-8")
    cold = write(tmp_path / "cold.csv", t[:2000], "w", values[:2000])
    assert run(capsys, "calibrate", "gyro", cold, "--plot", tmp_path / "cold.png")[0] == 0
    assert (tmp_path / "cold.png").stat().st_size > 10_000


def test_a_gyro_that_never_rests_is_bad_data(capsys, tmp_path):
    t = np.arange(0.0, 30.0, 0.01)
    moving = np.sin(3.0 * t)[:, None] * np.ones(3)
    path = write(tmp_path / "moving.csv", t, "w", moving, temp=np.full(t.size, 20.0))
    assert "moved" in failed(capsys, "calibrate", "gyro", path)


def attitudes(path, t, rng):
    angles = np.cumsum(rng.standard_normal((t.size // 40 + 2, 3)), axis=0) * 20.0
    knots = np.arange(len(angles)) * 40 * (t[1] - t[0])
    degrees = np.column_stack([np.interp(t, knots, column) for column in angles.T])
    smooth = np.column_stack([np.convolve(np.pad(c, 16, "edge"), np.hanning(33) / 16.0, "valid") for c in degrees.T])
    rows = np.column_stack((t, smooth))
    np.savetxt(path, rows, delimiter=",", header="t,roll_deg,pitch_deg,yaw_deg", comments="")
    return np.radians(smooth)


@pytest.mark.parametrize("sensor", ["accel", "gyro", "mag"])
def test_calibrate_against_a_reference_attitude(capsys, tmp_path, sensor):
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 25.0, 0.05)
    euler = attitudes(tmp_path / "encoders.csv", t, rng)
    truth = {
        "accel": lambda: reference_vectors(euler, np.array([0.0, 0.0, -G])),
        "gyro": lambda: reference_rates(t, euler, smoothing=0.0),
        "mag": lambda: reference_vectors(euler, np.array([22.5, 0.0, 41.8])),
    }[sensor]()
    gain, bias = np.array([[1.02, 0.01, 0.0], [-0.02, 0.98, 0.005], [0.0, 0.01, 1.01]]), np.array([0.02, -0.07, 0.05])
    noise = 1e-3 * rng.standard_normal(truth.shape)
    path = write(
        tmp_path / "log.csv", t, {"accel": "f", "gyro": "w", "mag": "m"}[sensor], truth @ gain.T + bias + noise
    )
    arguments = ["calibrate", sensor, path, "--reference", tmp_path / "encoders.csv", "--json"]
    status, printed = run(capsys, *arguments, "--field", "22.5,0,41.8", "--plot", tmp_path / "error.png")
    result = json.loads(printed.out)
    assert status == 0
    assert result["method"] == "reference"
    assert len(result["parameters"]) == 12
    np.testing.assert_allclose(result["gain"], gain, atol=6e-3)
    np.testing.assert_allclose(result["bias"], bias, atol=2e-3)
    assert np.all(np.array(result["rms_after"]) < np.array(result["rms_before"]))
    if sensor == "mag":
        assert "--field" in failed(capsys, *arguments)


def test_calibrate_against_a_reference_instrument(capsys, tmp_path):
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 20.0, 0.1)
    truth = np.column_stack([np.sin(0.5 * t + k) for k in range(3)]) * [1.0, 0.8, 0.6] + 0.1 * np.cos(1.7 * t)[:, None]
    truth[:, 2] += 0.5 * np.sin(2.3 * t)
    reference = write(tmp_path / "reference.csv", t, "w", truth)
    path = write(tmp_path / "log.csv", t, "w", 1.03 * truth + 0.01 + 1e-3 * rng.standard_normal(truth.shape))
    result = json.loads(run(capsys, "calibrate", "gyro", path, "--reference", reference, "--json")[1].out)
    np.testing.assert_allclose(np.diag(result["gain"]), 1.03, atol=2e-3)
    assert "moved" in result["quality"][0]


def test_references_that_are_none_are_bad_data(capsys, tmp_path):
    t = np.arange(0.0, 20.0, 0.1)
    path = write(tmp_path / "log.csv", t, "f", np.ones((t.size, 3)))
    other = write(tmp_path / "other.csv", t, "w", np.ones((t.size, 3)))
    assert "roll_deg" in failed(capsys, "calibrate", "accel", path, "--reference", other)
    later = write(tmp_path / "later.csv", t + 500.0, "f", np.ones((t.size, 3)))
    assert "no time in common" in failed(capsys, "calibrate", "accel", path, "--reference", later)
    words = tmp_path / "words.csv"
    words.write_text("t,roll_deg,pitch_deg,yaw_deg\n0,0,level,0\n", encoding="utf-8")
    assert "words.csv: could not" in failed(capsys, "calibrate", "accel", path, "--reference", words)
    short = tmp_path / "short.csv"
    short.write_text("t,roll_deg,pitch_deg,yaw_deg\n0,0,0,0\n1,0,0,0\n", encoding="utf-8")
    assert "at least 5 rows" in failed(capsys, "calibrate", "accel", path, "--reference", short)
    assert "no samples" in failed(capsys, "calibrate", "mag", path)


def test_calibrate_a_magnetometer_by_turning_it(capsys, tmp_path):
    rng = np.random.default_rng(8)
    u = rng.standard_normal((500, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    soft, hard = np.array([[1.1, 0.05, 0.1], [0.05, 0.95, -0.08], [0.1, -0.08, 1.02]]), np.array([5.0, -10.0, 20.0])
    path = write(
        tmp_path / "mag.csv", np.arange(500.0), "m", 48.0 * u @ soft + hard + 0.2 * rng.standard_normal(u.shape)
    )
    known = json.loads(run(capsys, "calibrate", "mag", path, "--field", 48, "--json")[1].out)
    np.testing.assert_allclose(known["gain"], soft, atol=5e-3)
    np.testing.assert_allclose(known["bias"], hard, atol=0.1)
    assert known["field_ut"] == 48.0
    vector = json.loads(run(capsys, "calibrate", "mag", path, "--field", "48,0,0", "--json")[1].out)
    assert vector["gain"] == known["gain"]
    unknown = json.loads(run(capsys, "calibrate", "mag", path, "--json")[1].out)
    assert np.linalg.det(unknown["gain"]) == pytest.approx(1.0)
    assert known["quality"] == unknown["quality"] == []


def test_errors_that_hang_together_are_remarked(capsys, tmp_path):
    # The field of a room wanders as the box is carried through it: 500 readings are not 500 of them.
    rng = np.random.default_rng(12)
    u = rng.standard_normal((500, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    size = 48.0 + np.convolve(rng.standard_normal(549), np.full(50, 0.05), "valid")
    path = write(tmp_path / "room.csv", np.arange(500.0), "m", size[:, None] * u)
    (remark,) = json.loads(run(capsys, "calibrate", "mag", path, "--json")[1].out)["quality"]
    assert "neighbouring errors are alike" in remark


@pytest.mark.parametrize(
    "arguments",
    [
        ["allan"],
        ["allan", "f", "--rate=-5"],
        ["allan", "f", "--shortest=-1"],
        ["allan", "f", "--plot", "figure.doc"],
        ["calibrate", "x", "f"],
        ["calibrate", "gyro", "f", "--speeds", "a"],
        ["calibrate", "accel", "f", "--window", "0"],
        ["calibrate", "accel", "f", "--gravity", "nine"],
        ["align", "f", "--lat", "100"],
        ["align", "f", "--lon=-200"],
        ["align", "f", "--accel-bias-mg", "inf"],
    ],
)
def test_bad_usage_is_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "Traceback" not in capsys.readouterr().err
