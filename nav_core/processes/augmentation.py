"""Processes put together: side by side, and augmented with the noise that is correlated in time (000 section 3.10)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nav_core.errors import ShapeError
from nav_core.processes.models import Process
from nav_core.processes.transition import Discrete
from nav_core.typing import Floats


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


def stack(*processes: Process) -> Process:
    """Independent processes side by side, e.g. three axes of one; states and noises in the order given."""
    from scipy.linalg import block_diag

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
