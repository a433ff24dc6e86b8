"""The differential equations of roll, pitch and yaw, and the auxiliary formulas for gimbal lock (000 §2.6.3, 004)."""

from __future__ import annotations

import numpy as np

from nav_core.errors import RangeError
from nav_core.rotation import GIMBAL_LOCK, wrap
from nav_core.typing import Floats, trailing


def euler_rates(euler: Floats, w_b: Floats) -> Floats:
    """Rates of roll, pitch and yaw at a body rate.

    Parameters
    ----------
    euler : ndarray, shape (..., 3)
        Roll, pitch, yaw, rad.
    w_b : ndarray, shape (..., 3)
        Rate of b against n, b axes, rad/s: ``(p', q', r')`` of 004, so without the turning of n itself.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s (000 eq. 2.6.21).

    Raises
    ------
    RangeError
        At pitch = ±pi/2, where roll and yaw have no rates.
    """
    roll, pitch, _ = np.moveaxis(trailing("euler", euler, 3), -1, 0)
    p, q, r = np.moveaxis(trailing("w_b", w_b, 3), -1, 0)
    level = np.cos(pitch)
    nearest = float(np.min(np.abs(level), initial=np.inf))
    if nearest < GIMBAL_LOCK:
        raise RangeError("cos(pitch)", nearest, f">= {GIMBAL_LOCK:g}")
    across = q * np.sin(roll) + r * np.cos(roll)
    return np.stack((p + across * np.tan(pitch), q * np.cos(roll) - r * np.sin(roll), across / level), axis=-1)


def body_rate(euler: Floats, rates: Floats) -> Floats:
    """Body rate of b against n, b axes, rad/s, shape (..., 3), from the rates of roll, pitch, yaw (000 eq. 2.6.20).

    Parameters
    ----------
    euler : ndarray, shape (..., 3)
        Roll, pitch, yaw of b against n, rad.
    rates : ndarray, shape (..., 3)
        Their rates, rad/s.

    Returns
    -------
    ndarray, shape (..., 3)
        rad/s, b axes.

    Raises
    ------
    ShapeError
    """
    roll, pitch, _ = np.moveaxis(trailing("euler", euler, 3), -1, 0)
    roll_rate, pitch_rate, yaw_rate = np.moveaxis(trailing("rates", rates, 3), -1, 0)
    p = roll_rate - yaw_rate * np.sin(pitch)
    q = pitch_rate * np.cos(roll) + yaw_rate * np.sin(roll) * np.cos(pitch)
    r = yaw_rate * np.cos(roll) * np.cos(pitch) - pitch_rate * np.sin(roll)
    return np.stack((p, q, r), axis=-1)


def gimbal_sums(R_nb: Floats) -> Floats:
    """Yaw plus roll, and yaw less roll, of an attitude matrix.

    Parameters
    ----------
    R_nb : ndarray, shape (..., 3, 3)

    Returns
    -------
    ndarray, shape (..., 2)
        ``yaw + roll`` and ``yaw - roll`` in [-pi, pi], rad.  At pitch = pi/2 the second alone is determined, at
        -pi/2 the first alone; the other is then without meaning.

    Notes
    -----
    004's four identities, with s the sine of pitch:
    ``C23 + C12 = (s - 1) sin(yaw + roll)``, ``C13 - C22 = (s - 1) cos(yaw + roll)``,
    ``C23 - C12 = (s + 1) sin(yaw - roll)``, ``C13 + C22 = (s + 1) cos(yaw - roll)``.
    """
    C = trailing("R_nb", R_nb, 3, 3)
    plus = np.arctan2(-(C[..., 1, 2] + C[..., 0, 1]), C[..., 1, 1] - C[..., 0, 2])
    minus = np.arctan2(C[..., 1, 2] - C[..., 0, 1], C[..., 0, 2] + C[..., 1, 1])
    return np.stack((plus, minus), axis=-1)


def euler_holding_roll(R_nb: Floats, roll: Floats | float) -> Floats:
    """Roll, pitch and yaw of an attitude matrix in gimbal lock, with the roll it had before.

    Parameters
    ----------
    R_nb : ndarray, shape (..., 3, 3)
        At or near pitch = ±pi/2.
    roll : float or ndarray, shape (...)
        To be kept, rad.

    Returns
    -------
    ndarray, shape (..., 3)
        Angles whose matrix is `R_nb` at pitch = ±pi/2, and departs from it by no more than the cosine of pitch near it.
    """
    C = trailing("R_nb", R_nb, 3, 3)
    sums = gimbal_sums(C)
    pitch = np.arctan2(-C[..., 2, 0], np.hypot(C[..., 0, 0], C[..., 1, 0]))
    roll = np.broadcast_to(np.asarray(roll, dtype=np.float64), pitch.shape)
    yaw = wrap(np.where(pitch > 0.0, sums[..., 1] + roll, sums[..., 0] - roll))
    return np.stack((roll, pitch, yaw), axis=-1)
