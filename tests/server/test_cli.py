"""The command line's fixed contract: names, options, JSON keys, exit statuses, and the speed of help."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from server.cli.main import main

MOUNT_KEYS = {
    "status", "method", "R_va", "euler_deg", "sigma_deg", "observability", "stable", "reliable", "self_test",
    "converged_after_s", "gps_lag_s", "changes", "reasons",
}  # fmt: skip


@pytest.fixture(scope="module")
def urban(tmp_path_factory):
    out = tmp_path_factory.mktemp("drive") / "urban.csv"
    arguments = ["simulate", str(out), "--route", "urban", "--minutes", "4", "--mount=-20,35,110", "--seed", "3"]
    assert main([*arguments, "--rate", "100"]) == 0
    return out


def run(capsys, *arguments):
    status = main([str(argument) for argument in arguments])
    return status, capsys.readouterr()


def test_help_answers_in_300_ms():
    def once():
        began = time.perf_counter()
        subprocess.run([sys.executable, "-m", "server.cli.main", "--help"], check=True, capture_output=True)
        return time.perf_counter() - began

    assert min(once() for _ in range(5)) < 0.3


def test_linear_algebra_has_one_thread_in_every_command():
    """Two workers on two cores took a third longer for a batch while each had threads that spun for small matrices."""
    code = """
from server.cli.main import main
main(["allan", "none.csv"])
import numpy as np
from pathlib import Path
np.ones((900, 900)) @ np.ones((900, 900))
names = [task.joinpath("comm").read_text() for task in Path("/proc/self/task").iterdir()]
print(names.count(Path("/proc/self/comm").read_text()))
"""
    clean = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, env=clean)
    assert done.stdout.split()[-1] == "1"


def test_simulate_writes_the_truth_beside_the_drive(urban):
    truth = json.loads(Path(f"{urban}.truth.json").read_text(encoding="utf-8"))
    assert truth["euler_deg"] == pytest.approx({"theta": -20.0, "phi": 35.0, "psi": 110.0})
    assert np.shape(truth["R_va"]) == (3, 3)
    header = urban.read_text(encoding="utf-8").split("\n", 1)[0].split(",")
    assert header[:4] == ["t", "fx", "fy", "fz"]
    assert {"lat", "lon", "alt", "speed", "course", "fix"} <= set(header)


def test_mount_prints_the_contract(capsys, urban):
    status, printed = run(capsys, "mount", urban, "--json")
    result = json.loads(printed.out)
    assert status == 0
    assert set(result) >= MOUNT_KEYS
    assert set(result["sigma_deg"]) == {"x", "y", "z"}
    truth = np.array(json.loads(Path(f"{urban}.truth.json").read_text(encoding="utf-8"))["R_va"])
    cosine = (np.trace(np.array(result["R_va"]) @ truth.T) - 1.0) / 2.0
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) < 4.0


def test_mount_says_what_became_of_the_rows(capsys, tmp_path, urban):
    header, *lines = urban.read_text(encoding="utf-8").splitlines()
    disordered = tmp_path / "disordered.csv"
    disordered.write_text("\n".join([header, *lines[100:200], *lines[:120], *lines[200:]]) + "\n", encoding="utf-8")
    status, printed = run(capsys, "mount", disordered, "--json")
    result = json.loads(printed.out)
    assert status == 0
    assert result["quality"][:2] == ["rows_out_of_order", "inertial_rows_repeated"]
    assert [told["code"] for told in result["quality_details"]] == result["quality"]
    assert "inertial rows repeat a time" in result["quality_details"][1]["detail"]


def test_mount_by_the_thesis_filter(capsys, urban):
    status, printed = run(capsys, "mount", urban, "--method", "mekf", "--json")
    assert status == 0
    assert json.loads(printed.out)["method"] == "mekf"


def test_mount_in_words(capsys, urban):
    status, printed = run(capsys, "mount", urban)
    assert status == 0
    assert "sigma about V" in printed.out


def test_parquet_and_csv_give_the_same_answer(capsys, tmp_path, urban):
    from server.formats.drive import read_drive_columns, write_drive_file

    parquet = tmp_path / "urban.parquet"
    write_drive_file(parquet, read_drive_columns(urban))
    assert run(capsys, "mount", parquet, "--json")[1].out == run(capsys, "mount", urban, "--json")[1].out


def test_a_standing_car_is_insufficient_and_status_0(capsys, tmp_path):
    out = tmp_path / "static.csv"
    assert run(capsys, "simulate", out, "--route", "static", "--minutes", "1", "--rate", "50")[0] == 0
    status, printed = run(capsys, "mount", out, "--json")
    result = json.loads(printed.out)
    assert status == 0
    assert result["status"] == "insufficient"
    assert result["R_va"] is result["euler_deg"] is result["sigma_deg"] is None
    assert result["reasons"]


@pytest.mark.parametrize(
    "content",
    ["", "hello world\n", "t,fx,fy\n0,1,2\n", "t,fx,fy,fz\n0,1,2,zero\n", "t,fx,fy,fz,lat,lon,alt,speed,course,fix\n"],
)
def test_bad_data_is_one_clear_line_and_status_1(capsys, tmp_path, content):
    path = tmp_path / "bad.csv"
    path.write_text(content, encoding="utf-8")
    status, printed = run(capsys, "mount", path, "--json")
    assert status == 1
    assert printed.out == ""
    assert printed.err.startswith("scatola: ")
    assert printed.err.count("\n") == 1


def test_a_missing_file_is_bad_data(capsys, tmp_path):
    status, printed = run(capsys, "mount", tmp_path / "none.csv")
    assert status == 1
    assert "none.csv" in printed.err


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nothing"],
        ["mount"],
        ["mount", "x", "--method", "guess"],
        ["simulate", "x", "--mount=1,2"],
        ["upload", "x"],
    ],
)
def test_bad_usage_is_status_2(arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2


def test_a_crash_and_a_move_are_in_the_truth(capsys, tmp_path):
    out = tmp_path / "crash.csv"
    arguments = ["--minutes", "3", "--rate", "50", "--crash", "120,32,-20,110", "--move", "60,10,0,0", "--json"]
    status, printed = run(capsys, "simulate", out, *arguments)
    truth = json.loads(printed.out)
    assert status == 0
    (event,) = truth["events"]
    assert event["delta_v_kmh"]["resultant"] == pytest.approx(32.0, abs=0.2)
    assert event["pdof_deg"] == pytest.approx(-20.0, abs=0.5)
    assert truth["changes"] == [{"t_s": 60.0, "angle_deg": pytest.approx(10.0)}]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("SCATOLA_DATABASE_URL", "postgresql://ada:hunter2@127.0.0.1:1/x", "scatola: the database: "),
        ("SCATOLA_DATABASE_URL", "nonsense-hunter2", "scatola: the database: "),
        ("SCATOLA_DATABASE_URL", "oracle+none://hunter2@x/y", "scatola: the database: "),
        ("SCATOLA_PORT", "hunter2", "scatola: settings: SCATOLA_PORT: "),
        ("SCATOLA_ADMIN_TOKEN_FILE", "/nowhere/token", "scatola: settings: SCATOLA_ADMIN_TOKEN_FILE: "),
    ],
)
@pytest.mark.parametrize("command", ["migrate", "serve", "verify"])
def test_a_server_that_does_not_answer_or_a_wrong_setting_is_one_clear_line(
    capsys, monkeypatch, tmp_path, command, name, value, said
):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(tmp_path))
    monkeypatch.setenv(name, value)
    monkeypatch.setattr("server.cli.processes.share_figures", lambda: None)  # it is for the whole of a process
    status, printed = run(capsys, command)
    assert status == 1
    lines = [line for line in printed.err.splitlines() if line.startswith("scatola: ")]
    assert len(lines) == 1
    assert lines[0].startswith(said)
    assert "hunter2" not in lines[0]
    assert "Traceback" not in printed.err


def test_a_database_that_was_never_migrated_is_one_clear_line(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("SCATOLA_DATA_DIR", str(tmp_path))
    status, printed = run(capsys, "verify")
    assert (status, printed.err.count("\n")) == (1, 1)
    assert "no such table" in printed.err


def test_a_mistake_of_ours_keeps_its_traceback(monkeypatch):
    monkeypatch.setattr("server.cli.files.mount", lambda _: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        main(["mount", "x"])
