"""Transition matrices and discrete noise of linear dynamics ``x' = F x + G w`` (000 section 3.6, 003)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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


def order_of(F: Floats) -> int:
    """Number of states: n of an (n, n) matrix.

    Parameters
    ----------
    F : ndarray, shape (n, n)
        Dynamics, 1/s.

    Returns
    -------
    int
        n.

    Raises
    ------
    ShapeError
    """
    if F.ndim != 2 or F.shape[0] != F.shape[1]:
        raise ShapeError("F", F.shape, "(n, n)")
    return F.shape[0]


def exponential(A: Floats) -> Floats:
    """Matrix exponential, shape of `A` (..., n, n).

    Parameters
    ----------
    A : ndarray, shape (..., n, n)
        Without unit.

    Returns
    -------
    ndarray, shape (..., n, n)
        ``exp(A)``, by scipy.
    """
    from scipy.linalg import expm

    return np.asarray(expm(A), dtype=np.float64)


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
    Phi = term = np.eye(order_of(F))
    for power in range(1, order + 1):
        term = term @ F * (dt / power)
        Phi = Phi + term
    return Phi


def transition(F: Floats, dt: float) -> Floats:
    """Transition matrix of constant dynamics, ``exp(F dt)`` (000 eqs. 3.6.12, 3.6.29), shape (n, n).

    Parameters
    ----------
    F : ndarray, shape (n, n)
        Dynamics, 1/s.
    dt : float
        s.

    Returns
    -------
    ndarray, shape (n, n)
        From the start of the step to its end.

    Raises
    ------
    ShapeError
    """
    order_of(F)
    return exponential(F * dt)


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
    n = order_of(F)
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
    for step in exponential(F * dt):
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

    Notes
    -----
    The exponential holds ``exp(-F dt)``: keep `dt` below some ten times the shortest time constant.
    """
    n = order_of(F)
    if diffusion.shape != (n, n):
        raise ShapeError("diffusion", diffusion.shape, f"({n}, {n})")
    both = exponential(np.block([[-F, diffusion], [np.zeros((n, n)), F.T]]) * dt)
    Phi = both[n:, n:].T
    Q = Phi @ both[:n, n:]
    return Discrete(Phi, np.add(Q, Q.T) / 2.0)


def first_order_noise(diffusion: Floats, dt: float) -> Floats:
    """``G Q G' dt``: the discrete noise of a step short against the dynamics (000 eq. 3.6.31), shape (n, n).

    Parameters
    ----------
    diffusion : ndarray, shape (n, n)
        ``G Q G'``, covariance per s.
    dt : float
        s.

    Returns
    -------
    ndarray, shape (n, n)
        Covariance.
    """
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
    n = order_of(F)
    if B.ndim != 2 or B.shape[0] != n:
        raise ShapeError("B", B.shape, f"({n}, q)")
    q = B.shape[1]
    return exponential(np.block([[F, B], [np.zeros((q, n + q))]]) * dt)[:n, n:]


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
