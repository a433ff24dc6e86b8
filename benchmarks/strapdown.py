"""What strapdown costs: a step of each mechanisation, the increments before it, and the peer on the same increments."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from timing import Row, best, print_rows


def rows() -> list[Row]:
    """All on one simulated drive of 10 min at 100 Hz."""
    import pandas as pd

    from nav_core import earth
    from nav_core.simulate import Scenario, simulate
    from nav_core.simulate.globe import on_the_globe
    from nav_core.strapdown import cartesian_kernels, from_integrals, from_rates, kernels, wander_kernels

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from pyins import strapdown as peer
        from pyins import transform

    _, truth = simulate(Scenario(route="urban", duration=600.0, accel_rate=100.0).faultless(), seed=1)
    drive = on_the_globe(truth, (0.7866, 0.1342, 240.0), level=True)
    increments = from_rates(drive.t, drive.w_v, drive.f_v)
    driven = increments.rotation, increments.velocity, increments.periods
    n = increments.periods.size
    place, v, C = np.array([0.7866, 0.1342, 240.0]), drive.velocity[0], drive.R_tv[0]
    R_et = earth.tangent_axes(0.7866, 0.1342)
    cartesian = earth.geodetic_to_ecef(*place), R_et @ v, R_et @ C
    runs: list[tuple[str, Callable[[], object]]] = [
        ("n, north east down", lambda: kernels.run_local(place, v, C, *driven, True, False)),
        ("n, north east up", lambda: kernels.run_local(place, v, C, *driven, True, True)),
        ("wander azimuth", lambda: wander_kernels.run_wander(R_et, 240.0, v, C, *driven, True)),
        ("e", lambda: cartesian_kernels.run_cartesian(*cartesian, *driven, True, False)),
        ("i", lambda: cartesian_kernels.run_cartesian(*cartesian, *driven, True, True)),
    ]
    measured = [Row(f"strapdown step, {name}", 1e6 * best(run) / n, "µs", "≤ 1 µs") for name, run in runs]
    angle, thrust = increments.rotation, increments.velocity
    gathered = best(lambda: from_integrals(increments.t, angle, thrust))
    measured.append(Row("coning and sculling, per reading", 1e6 * gathered / n, "µs"))

    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    pva = pd.Series([*np.degrees(place[:2]), 240.0, *v, *transform.mat_to_rph(C)], index=names)
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    table = pd.DataFrame(np.column_stack((increments.periods, angle, thrust)), index=increments.t[1:], columns=columns)

    def peers() -> object:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return peer.Integrator(pva, with_altitude=False).integrate(table)

    measured.append(Row("python-ins, per step with its table", 1e6 * best(peers, repeat=3) / n, "µs"))
    return measured


if __name__ == "__main__":
    print_rows(rows())
