"""Turn one sign of a filter at a time and show that a test fails: a copy is changed, never this checkout.

.venv/bin/python scripts/flip_signs.py [NUMBER ...]

Status 1 when a turned sign goes unnoticed, when its line is no longer there, or when the test fails without it.
The compiler stays off, so that nothing stale is run.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Flip(NamedTuple):
    """In `module`, `line` becomes `flipped`; `test` then fails."""

    module: str
    line: str
    flipped: str
    test: str


FLIPS = (
    Flip(
        "attitude/error_state_kernel.py",
        "seen[0] - x, seen[1] - y, seen[2] - z",
        "seen[0] - x, seen[1] + y, seen[2] - z",
        "test_attitude_error_state.py::test_the_kernel_agrees_with_the_matrices",
    ),
    Flip(
        "attitude/error_state_kernel.py",
        "b[i] += dx[3 + i]",
        "b[i] -= dx[3 + i]",
        "test_attitude_error_state.py::test_the_kernel_agrees_with_the_matrices",
    ),
    Flip(
        "attitude/quaternion_ekf.py",
        "F[:4, 4:] = D[:4, :3] = -X",
        "F[:4, 4:] = D[:4, :3] = X",
        "test_attitude_control_unit.py::test_the_perturbation_model_is_the_derivative_and_the_print_is_not",
    ),
    Flip(
        "attitude/quaternion_ekf.py",
        "Phi[0, 4], Phi[0, 5], Phi[0, 6] = h * q[3], -h * q[2], h * q[1]",
        "Phi[0, 4], Phi[0, 5], Phi[0, 6] = h * q[3], h * q[2], h * q[1]",
        "test_attitude_control_unit.py::test_the_kernel_agrees_with_the_matrices",
    ),
    Flip(
        "attitude/vertical.py",
        "u_rate, u * r, -u * q",
        "u_rate, -u * r, -u * q",
        "test_attitude_control_unit.py::test_a_right_turn_accelerates_to_the_right_and_climbing_over_a_crest_downwards",
    ),
    Flip(
        "navigation/kernels.py",
        "Phi[3, 7], Phi[3, 8], Phi[4, 6] = z * T, -y * T, -z * T",
        "Phi[3, 7], Phi[3, 8], Phi[4, 6] = z * T, -y * T, z * T",
        "test_navigation_inertial_gnss.py::test_the_kernel_agrees_with_the_matrices",
    ),
    Flip(
        "navigation/rows.py",
        "e[row] = -body[i] - swing[i]",
        "e[row] = -body[i] + swing[i]",
        "test_navigation_inertial_gnss.py::test_the_slip_free_point_is_where_the_arm_says",
    ),
    Flip(
        "navigation/rows.py",
        "e[i] -= H[i, VEHICLE + i] * slow[6 + i]",
        "e[i] += H[i, VEHICLE + i] * slow[6 + i]",
        "test_navigation_inertial_gnss.py::test_the_kernel_agrees_with_the_matrices",
    ),
    Flip(
        "navigation/position_velocity.py",
        "motion = np.column_stack((_integral(t, velocity), velocity))",
        "motion = np.column_stack((-_integral(t, velocity), velocity))",
        "test_navigation_position_velocity.py::test_a_drive_without_gyro",
    ),
    Flip(
        "strapdown/kernels.py",
        "return v[1] * across, -v[0] * along, -v[1] * across * tan_lat",
        "return v[1] * across, v[0] * along, -v[1] * across * tan_lat",
        "test_strapdown_mechanisation.py::test_the_local_step_agrees_with_matrices",
    ),
    Flip(
        "strapdown/increments.py",
        "scull = total(cross(a, gained), 1.0, cross(u, turned))",
        "scull = total(cross(a, gained), -1.0, cross(u, turned))",
        "test_strapdown_increments.py::test_the_recursion_is_a_double_sum",
    ),
    Flip(
        "alignment/magnetic.py",
        "design = -np.vstack([skew(expected[:3]), skew(expected[3:])])",
        "design = np.vstack([skew(expected[:3]), skew(expected[3:])])",
        "test_alignment.py::test_gauss_newton_is_wahba",
    ),
    Flip(
        "kalman/record_kernels.py",
        "x[k] += C @ (x[k + 1] - x_prior[k + 1])",
        "x[k] -= C @ (x[k + 1] - x_prior[k + 1])",
        "test_kalman.py::test_filterpy_smooths_the_same",
    ),
    Flip(
        "mounting/online_prediction.py",
        "F[TRACK, BANK], F[TRACK, BIAS + 1] = -GRAVITY * row[PER_SPEED], -row[PER_SPEED]",
        "F[TRACK, BANK], F[TRACK, BIAS + 1] = -GRAVITY * row[PER_SPEED], row[PER_SPEED]",
        "test_mounting_online.py::test_the_kernel_agrees_with_the_matrices",
    ),
    Flip(
        "mounting/online_measurements.py",
        "nu -= h[k] * x[columns[k]]",
        "nu += h[k] * x[columns[k]]",
        "test_mounting_online.py::test_the_kernel_agrees_with_the_matrices",
    ),
    Flip(
        "crash/pulse.py",
        "q = rotvec_to_quaternion(middle * step)",
        "q = rotvec_to_quaternion(-middle * step)",
        "test_crash_pulse.py::test_a_blow_that_turns_the_vehicle_is_integrated_in_the_axes_at_time_zero",
    ),
    Flip(
        "navigation/inertial_gnss.py",
        "smooth_backwards(-run.dx, run.P_prior",
        "smooth_backwards(run.dx, run.P_prior",
        "test_navigation_inertial_gnss.py::test_smoothing_helps_and_claims_less_uncertainty",
    ),
    Flip(
        "navigation/inertial_gnss.py",
        "            -e[:, 2],",
        "            e[:, 2],",
        "test_navigation_inertial_gnss.py::test_a_track_is_moved_as_the_kernel_moves_an_epoch",
    ),
    Flip(
        "kalman/kernels.py",
        "(row[j] - in_row * Ph[j]) + left * gain[j]",
        "(row[j] + in_row * Ph[j]) + left * gain[j]",
        "test_kalman.py::test_one_by_one_is_the_joint_update",
    ),
)


def passes(folder: Path, test: str) -> bool:
    """Whether a test passes in a copy."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n0", "-p", "no:cacheprovider", f"tests/nav_core/{test}"]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": str(folder)}
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)  # noqa: S603
    if run.returncode not in (0, 1):
        sys.exit(f"{test} does not run:\n{run.stdout}{run.stderr}")
    return run.returncode == 0


def noticed(folder: Path, flip: Flip) -> bool:
    """Whether the test passes as things are and fails with the sign turned."""
    path = folder / "nav_core" / flip.module
    source = path.read_text(encoding="utf-8")
    if source.count(flip.line) != 1:
        sys.exit(f"{flip.module}: {source.count(flip.line)} times {flip.line!r}")
    if not passes(folder, flip.test):
        sys.exit(f"{flip.test} fails as things are")
    path.write_text(source.replace(flip.line, flip.flipped), encoding="utf-8")
    failed = not passes(folder, flip.test)
    path.write_text(source, encoding="utf-8")
    return failed


def main() -> None:
    wanted = [int(number) for number in sys.argv[1:]] or range(len(FLIPS))
    with TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("nav_core", "tests"):
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", folder)
        found = []
        for number in wanted:
            flip = FLIPS[number]
            found.append(noticed(folder, flip))
            print(f"{number:2} {'noticed' if found[-1] else 'MISSED '} {flip.module}: {flip.flipped}", flush=True)
    print(f"{sum(found)} of {len(found)} noticed")
    sys.exit(0 if all(found) else 1)


if __name__ == "__main__":
    main()
