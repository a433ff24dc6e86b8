"""The processes of navigation: random walk, PV, PVA, Gauss-Markov, damped spring; each also in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nav_core.errors import RangeError, ShapeError
from nav_core.processes.transition import Discrete, order_of, van_loan
from nav_core.typing import Floats


@dataclass(frozen=True, slots=True)
class Process:
    """``x' = F x + G w`` (000 eq. 3.4.2).

    Attributes
    ----------
    F : ndarray, shape (n, n)
        Dynamics, 1/s and mixed.
    G : ndarray, shape (n, r)
        Where the noise enters.
    Q : ndarray, shape (r, r)
        Spectral density of the noise: units of `w` squared times s.
    """

    F: Floats
    G: Floats
    Q: Floats

    def __post_init__(self) -> None:
        n = order_of(self.F)
        if self.G.ndim != 2 or self.G.shape[0] != n:
            raise ShapeError("G", self.G.shape, f"({n}, r)")
        r = self.G.shape[1]
        if self.Q.shape != (r, r):
            raise ShapeError("Q", self.Q.shape, f"({r}, {r})")

    @property
    def diffusion(self) -> Floats:
        """``G Q G'``, shape (n, n): how fast the noise adds covariance."""
        return self.G @ self.Q @ self.G.T

    def discrete(self, dt: float) -> Discrete:
        """Over a step of `dt` s, exactly (Van Loan).

        Parameters
        ----------
        dt : float
            s.

        Returns
        -------
        Discrete
            Transition and noise of the step.
        """
        return van_loan(self.F, self.diffusion, dt)


def _positive(name: str, value: float) -> float:
    if not value > 0.0:
        raise RangeError(name, value, "more than 0")
    return value


def integrators(order: int, density: float) -> Process:
    """A chain of integrators driven by white noise at its end (000 eqs. 3.6.7, 3.6.8).

    Parameters
    ----------
    order : int
        1 is a random walk, 2 the PV model (nearly uniform motion), 3 the PVA model (nearly uniform acceleration).
    density : float
        Spectral density of the last derivative, e.g. (m/s²)²s for PV, (m/s³)²s for PVA.

    Returns
    -------
    Process
        States: position and its derivatives.  The noise is a scalar (003 prints a column of three for PV).

    Raises
    ------
    RangeError
    """
    if order < 1:
        raise RangeError("order", order, "1 or more")
    return Process(np.eye(order, k=1), np.eye(order)[:, -1:], np.array([[density]]))


def random_walk(density: float) -> Process:
    """White noise summed up (000 eq. 3.9.3): one state whose variance grows by `density` every second.

    Parameters
    ----------
    density : float
        Of the white noise, (unit of the state)²/s.

    Returns
    -------
    Process
        One state.
    """
    return integrators(1, density)


def position_velocity(density: float) -> Process:
    """PV model: white acceleration of `density` (m/s²)²s (003).

    Parameters
    ----------
    density : float
        Of the acceleration.

    Returns
    -------
    Process
        States m, m/s.
    """
    return integrators(2, density)


def position_velocity_acceleration(density: float) -> Process:
    """PVA model: white jerk of `density` (m/s³)²s (003).

    Parameters
    ----------
    density : float
        Of the jerk.

    Returns
    -------
    Process
        States m, m/s, m/s².
    """
    return integrators(3, density)


def gauss_markov(sigma: float, tau: float) -> Process:
    """First-order Gauss-Markov process, exponentially correlated (000 eqs. 3.9.4, 3.9.5).

    Parameters
    ----------
    sigma : float
        Standard deviation in the long run.
    tau : float
        Correlation time, s.

    Returns
    -------
    Process
        One state, in the unit of `sigma`.

    Raises
    ------
    RangeError
    """
    _positive("tau", tau)
    return Process(np.array([[-1.0 / tau]]), np.ones((1, 1)), np.array([[2.0 * sigma**2 / tau]]))


def gauss_markov_covariance(sigma: float, tau: float, lag: Floats) -> Floats:
    """Autocovariance ``sigma² exp(-abs(lag) / tau)`` of `gauss_markov` (000 eq. 3.9.6), the shape of `lag` (s).

    Parameters
    ----------
    sigma : float
        1-sigma, in any unit.
    tau : float
        s, more than 0.
    lag : ndarray, shape (...)
        s.

    Returns
    -------
    ndarray, shape (...)
        In the square of that unit.

    Raises
    ------
    RangeError
    """
    return sigma**2 * np.exp(-np.abs(lag) / _positive("tau", tau))


def spring(mass: float, damping: float, stiffness: float, density: float = 1.0) -> Process:
    """A mass on a damped spring pushed by white force (000 eqs. 3.4.3-3.4.6, 3.5.2).

    Parameters
    ----------
    mass, damping, stiffness : float
        kg, N s/m, N/m.
    density : float
        Spectral density of the force, N²s.

    Returns
    -------
    Process
        States: displacement m, velocity m/s.

    Raises
    ------
    RangeError

    Notes
    -----
    3.4.4 prints ``-w / m``; the force pushes the way it points, as in 3.4.6.
    """
    _positive("mass", mass)
    F = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]])
    return Process(F, np.array([[0.0], [1.0 / mass]]), np.array([[density]]))


def position_velocity_discrete(density: float, dt: float) -> Discrete:
    """`position_velocity` over `dt` s in closed form (003; 000 eq. 3.6.28).

    Parameters
    ----------
    density : float
        (m/s²)²s.
    dt : float
        s.

    Returns
    -------
    Discrete
        Shapes (2, 2).
    """
    Phi = np.array([[1.0, dt], [0.0, 1.0]])
    return Discrete(Phi, density * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]))


def position_velocity_acceleration_discrete(density: float, dt: float) -> Discrete:
    """`position_velocity_acceleration` over `dt` s in closed form.

    Parameters
    ----------
    density : float
        (m/s³)²s.
    dt : float
        s.

    Returns
    -------
    Discrete
        Shapes (3, 3).

    Notes
    -----
    003 prints ``dt²`` in the corner of `Phi`; the series it is derived from gives ``dt² / 2``.
    """
    Phi = np.array([[1.0, dt, dt**2 / 2.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    Q = np.array(
        [
            [dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0],
            [dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0],
            [dt**3 / 6.0, dt**2 / 2.0, dt],
        ]
    )
    return Discrete(Phi, density * Q)


def gauss_markov_discrete(sigma: float, tau: float, dt: float) -> Discrete:
    """`gauss_markov` over `dt` s in closed form (000 eqs. 3.9.4, 3.9.5).

    Parameters
    ----------
    sigma : float
        1-sigma, in any unit.
    tau : float
        s, more than 0.
    dt : float
        s.

    Returns
    -------
    Discrete
        Shapes (1, 1).

    Raises
    ------
    RangeError
    """
    decay = np.exp(-dt / _positive("tau", tau))
    return Discrete(np.array([[decay]]), np.array([[-(sigma**2) * np.expm1(-2.0 * dt / tau)]]))
