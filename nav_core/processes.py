"""Linear stochastic processes: transition matrices, discrete noise, correlated noise, augmentation.

A process is ``x' = F x + G w`` with white `w` of spectral density `Q` (000 eq. 3.4.2); over a step `dt` it becomes
``x(k+1) = Phi x(k) + w(k)`` with ``E[w(k) w(k)'] = Q`` (000 eqs. 3.6.17, 3.6.28).  Four ways lead to `Phi` and to
the noise: the truncated series, the inverse Laplace transform of the resolvent, the matrix exponential (with it
Van Loan's integral of the noise), and for the common processes a closed form.

003 is the lecture deck on state space.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, expm

from nav_core.errors import RangeError, ShapeError
from nav_core.typing import Floats

CONFLUENT = 1e-6
"""Eigenvalues whose difference times `dt` is smaller than this are taken as one in the inverse Laplace transform."""


class Discrete(NamedTuple):
    """A process over one step.

    Attributes
    ----------
    Phi : ndarray, shape (n, n)
        Transition matrix: the state after the step is ``Phi @ x``.
    Q : ndarray, shape (n, n)
        Covariance of what the noise adds within the step.
    """

    Phi: Floats
    Q: Floats


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
        n = _order(self.F)
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
        """Over a step of `dt` s, exactly (Van Loan)."""
        return van_loan(self.F, self.diffusion, dt)


class ShapingFilter(NamedTuple):
    """Correlated noise as the output ``H x`` of a process driven by white noise (000 eqs. 3.10.17, 3.10.18).

    Attributes
    ----------
    process : Process
    H : ndarray, shape (m, n)
        Its output; the white part that the print adds as `v` belongs to the noise of what it feeds.
    """

    process: Process
    H: Floats


class Augmented(NamedTuple):
    """A process together with the shaping filters of its correlated noise (000 eqs. 3.10.23, 3.10.24).

    Attributes
    ----------
    process : Process
        States in the order: system, correlated driving noise, correlated sensor noise.
    H : ndarray, shape (m, n)
        Measurement matrix of the whole.
    """

    process: Process
    H: Floats


def _order(F: Floats) -> int:
    if F.ndim != 2 or F.shape[0] != F.shape[1]:
        raise ShapeError("F", F.shape, "(n, n)")
    return F.shape[0]


def _positive(name: str, value: float) -> float:
    if not value > 0.0:
        raise RangeError(name, value, "more than 0")
    return value


# Transition matrices ------------------------------------------------------------------------------------------


def transition_series(F: Floats, dt: float, order: int) -> Floats:
    """Transition matrix by its power series up to ``F**order`` (000 eq. 3.6.30, 003).

    Exact where ``F`` to the power ``order + 1`` vanishes: order 1 for PV, 2 for PVA.

    Parameters
    ----------
    F : ndarray, shape (n, n)
    dt : float
        s.
    order : int
        Last power kept; 1 or more.

    Returns
    -------
    ndarray, shape (n, n)

    Raises
    ------
    ShapeError, RangeError
    """
    if order < 1:
        raise RangeError("order", order, "1 or more")
    Phi = term = np.eye(_order(F))
    for power in range(1, order + 1):
        term = term @ F * (dt / power)
        Phi = Phi + term
    return Phi


def transition(F: Floats, dt: float) -> Floats:
    """Transition matrix of constant dynamics, ``exp(F dt)`` (000 eqs. 3.6.12, 3.6.29), shape (n, n).

    Raises
    ------
    ShapeError
    """
    _order(F)
    return expm(F * dt)


def transition_laplace(F: Floats, dt: float) -> Floats:
    """Transition matrix as the inverse Laplace transform of ``(s I - F)^-1`` (003).

    The resolvent is expanded over the eigenvalues, ``sum_k prod_{j<k} (F - l_j I) / prod_{j<=k} (s - l_j)``; the
    inverse transform of each fraction is the divided difference of ``exp(l t)`` over ``l_0 .. l_k`` (Putzer).

    Parameters
    ----------
    F : ndarray, shape (n, n)
        Not so large that its eigenvalues cannot be found well: a handful of states.
    dt : float
        s.

    Returns
    -------
    ndarray, shape (n, n)

    Raises
    ------
    ShapeError

    Notes
    -----
    Eigenvalues that lie within `CONFLUENT` of each other over the step count as equal.
    """
    n = _order(F)
    nodes = np.sort_complex(np.linalg.eigvals(F)) * dt
    differences = np.exp(nodes)
    weights = [differences[0]]
    for k in range(1, n):
        gap = nodes[k:] - nodes[:-k]
        apart = np.abs(gap) > CONFLUENT
        # Over equal nodes the divided difference of order k is the k-th derivative over k!.
        middle = np.exp(0.5 * (nodes[k:] + nodes[:-k])) / float(np.prod(np.arange(1, k + 1)))
        quotient = np.diff(differences) / np.where(apart, gap, 1.0)
        differences = np.where(apart, quotient, middle)
        weights.append(differences[0])
    Phi, product = np.zeros((n, n), dtype=np.complex128), np.eye(n, dtype=np.complex128)
    for node, weight in zip(nodes, weights, strict=True):
        Phi += weight * product
        product = product @ (F * dt - node * np.eye(n))
    return np.ascontiguousarray(Phi.real)


def transition_varying(F: Floats, dt: float) -> Floats:
    """Transition matrix over many steps of changing dynamics: the later factor stands on the left.

    Parameters
    ----------
    F : ndarray, shape (k, n, n)
        Dynamics in the middle of each step, in the order of time.
    dt : float
        Length of a step, s.

    Returns
    -------
    ndarray, shape (n, n)
        From the start of the first step to the end of the last.  Error of second order in `dt`.

    Raises
    ------
    ShapeError

    Notes
    -----
    003 writes ``Phi(t1, t2) Phi(t2, t3)`` in the reverse order, and the exponential of the integral of `F`; that
    only holds where `F` at different times commutes (000 properties 3, 4 of section 3.6.3).
    """
    if F.ndim != 3 or F.shape[1] != F.shape[2]:
        raise ShapeError("F", F.shape, "(k, n, n)")
    Phi = np.eye(F.shape[1])
    for step in expm(F * dt):
        Phi = step @ Phi
    return Phi


def van_loan(F: Floats, diffusion: Floats, dt: float) -> Discrete:
    """Transition matrix and discrete noise from one matrix exponential (Van Loan 1978; 000 eq. 3.6.28).

    Parameters
    ----------
    F : ndarray, shape (n, n)
    diffusion : ndarray, shape (n, n)
        ``G Q G'``.
    dt : float
        s.

    Returns
    -------
    Discrete

    Raises
    ------
    ShapeError
    """
    n = _order(F)
    if diffusion.shape != (n, n):
        raise ShapeError("diffusion", diffusion.shape, f"({n}, {n})")
    both = expm(np.block([[-F, diffusion], [np.zeros((n, n)), F.T]]) * dt)
    Phi = both[n:, n:].T
    Q = Phi @ both[:n, n:]
    return Discrete(Phi, 0.5 * (Q + Q.T))


def first_order_noise(diffusion: Floats, dt: float) -> Floats:
    """``G Q G' dt``: the discrete noise of a step short against the dynamics (000 eq. 3.6.31), shape (n, n)."""
    return diffusion * dt


def input_matrix(F: Floats, B: Floats, dt: float) -> Floats:
    """Effect of an input that is constant within the step (000 eq. 3.6.26).

    Parameters
    ----------
    F : ndarray, shape (n, n)
    B : ndarray, shape (n, q)
    dt : float
        s.

    Returns
    -------
    ndarray, shape (n, q)
        ``integral of Phi(t_k+1, tau) B dtau``: the state after the step is ``Phi @ x + this @ u``.

    Raises
    ------
    ShapeError

    Notes
    -----
    The print writes ``Phi(t, tau)``; the upper end is ``t_k+1``.
    """
    n = _order(F)
    if B.ndim != 2 or B.shape[0] != n:
        raise ShapeError("B", B.shape, f"({n}, q)")
    q = B.shape[1]
    return expm(np.block([[F, B], [np.zeros((q, n + q))]]) * dt)[:n, n:]


def evolve(F: Floats, B: Floats, x: Floats, u: Floats, dt: float) -> Floats:
    """Free and forced evolution under inputs that hold for a step each (003; 000 eq. 3.6.23).

    Parameters
    ----------
    F : ndarray, shape (n, n)
    B : ndarray, shape (n, q)
    x : ndarray, shape (n,)
        State at the start.
    u : ndarray, shape (k, q)
        Inputs, one a step.
    dt : float
        s.

    Returns
    -------
    ndarray, shape (k + 1, n)
        States at the ends of the steps, the start first.

    Raises
    ------
    ShapeError
    """
    Phi, Gamma = transition(F, dt), input_matrix(F, B, dt)
    states = [x]
    for step in u:
        states.append(Phi @ states[-1] + Gamma @ step)
    return np.array(states)


# Processes ----------------------------------------------------------------------------------------------------


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
    """White noise summed up (000 eq. 3.9.3): one state whose variance grows by `density` every second."""
    return integrators(1, density)


def position_velocity(density: float) -> Process:
    """PV model: white acceleration of `density` (m/s²)²s (003)."""
    return integrators(2, density)


def position_velocity_acceleration(density: float) -> Process:
    """PVA model: white jerk of `density` (m/s³)²s (003)."""
    return integrators(3, density)


def gauss_markov(sigma: float, tau: float) -> Process:
    """First-order Gauss-Markov process, exponentially correlated (000 eqs. 3.9.4, 3.9.5).

    Parameters
    ----------
    sigma : float
        Standard deviation in the long run.
    tau : float
        Correlation time, s.

    Raises
    ------
    RangeError
    """
    _positive("tau", tau)
    return Process(np.array([[-1.0 / tau]]), np.ones((1, 1)), np.array([[2.0 * sigma**2 / tau]]))


def gauss_markov_covariance(sigma: float, tau: float, lag: Floats) -> Floats:
    """Autocovariance ``sigma² exp(-abs(lag) / tau)`` of `gauss_markov` (000 eq. 3.9.6), the shape of `lag` (s)."""
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


# Closed forms -------------------------------------------------------------------------------------------------


def position_velocity_discrete(density: float, dt: float) -> Discrete:
    """`position_velocity` over `dt` s in closed form (003; 000 eq. 3.6.28)."""
    Phi = np.array([[1.0, dt], [0.0, 1.0]])
    return Discrete(Phi, density * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]))


def position_velocity_acceleration_discrete(density: float, dt: float) -> Discrete:
    """`position_velocity_acceleration` over `dt` s in closed form.

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

    Raises
    ------
    RangeError
    """
    decay = np.exp(-dt / _positive("tau", tau))
    return Discrete(np.array([[decay]]), np.array([[-(sigma**2) * np.expm1(-2.0 * dt / tau)]]))


# Composition --------------------------------------------------------------------------------------------------


def stack(*processes: Process) -> Process:
    """Independent processes side by side, e.g. three axes of one; states and noises in the order given."""
    return Process(
        np.asarray(block_diag(*(process.F for process in processes))),
        np.asarray(block_diag(*(process.G for process in processes))),
        np.asarray(block_diag(*(process.Q for process in processes))),
    )


def augment(
    process: Process,
    H: Floats,
    *,
    driving: ShapingFilter | None = None,
    D: Floats | None = None,
    sensor: ShapingFilter | None = None,
) -> Augmented:
    """Append correlated noise to the state, so that only white noise is left (000 section 3.10).

    Parameters
    ----------
    process : Process
        n states; keeps its own white noise.
    H : ndarray, shape (m, n)
        Measurement matrix.
    driving : ShapingFilter, optional
        Correlated noise of the dynamics (3.10.1-3.10.6, 3.10.13).
    D : ndarray, shape (n, r), optional
        Where it enters; by default where the white noise does, ``process.G``.
    sensor : ShapingFilter, optional
        Correlated noise of the m measurements (3.10.7-3.10.9).

    Returns
    -------
    Augmented

    Raises
    ------
    ShapeError
        Outputs and inputs do not fit.

    Notes
    -----
    3.10.23 and 3.10.25 as printed have ``F_xi`` for ``F_eps``, and on the diagonal of the discrete form `H` where
    the transition matrices of the filters belong.
    """
    n = process.F.shape[0]
    if H.ndim != 2 or H.shape[1] != n:
        raise ShapeError("H", H.shape, f"(m, {n})")
    inlet = process.G if D is None else D
    parts, measured = [process], [H]
    couplings: list[Floats] = []
    if driving is not None:
        if inlet.shape != (n, driving.H.shape[0]):
            raise ShapeError("D", inlet.shape, f"({n}, {driving.H.shape[0]})")
        parts.append(driving.process)
        measured.append(np.zeros((H.shape[0], driving.H.shape[1])))
        couplings.append(inlet @ driving.H)
    if sensor is not None:
        if sensor.H.shape[0] != H.shape[0]:
            raise ShapeError("sensor.H", sensor.H.shape, f"({H.shape[0]}, k)")
        parts.append(sensor.process)
        measured.append(sensor.H)
    whole = stack(*parts)
    for coupling in couplings:
        whole.F[:n, n : n + coupling.shape[1]] = coupling
    return Augmented(whole, np.hstack(measured))


def sample_path(discrete: Discrete, x: Floats, steps: int, rng: np.random.Generator) -> Floats:
    """One realisation of a process.

    Parameters
    ----------
    discrete : Discrete
        n states.
    x : ndarray, shape (..., n)
        State(s) at the start; leading axes are independent realisations.
    steps : int
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (steps + 1, ..., n)
        The start first.
    """
    # Not by Cholesky: a discrete noise is often singular, e.g. where a state is only an integral of another.
    values, vectors = np.linalg.eigh(discrete.Q)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    path = np.empty((steps + 1, *x.shape))
    path[0] = x
    for k in range(steps):
        path[k + 1] = path[k] @ discrete.Phi.T + rng.standard_normal(x.shape) @ root.T
    return path
