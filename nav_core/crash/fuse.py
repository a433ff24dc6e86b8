"""Delta-V from the accelerometer, clipped or not, and from the fixes, as one distribution.

What clipping hides is known up to a factor, the rest up to normal errors, the fixes' change likewise.  The logarithm of
the factor has Student's distribution: where the flanks mislead, they mislead by much, and the fixes must be able to say
so.  Given the factor all is linear and normal; the factor is summed over on a grid.  The distribution is carried
as weighted points, so that intervals of components, resultant and angle agree with each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from nav_core.events.record import Estimate
from nav_core.rotation import wrap
from nav_core.typing import Floats

FACTORS = 121
FREEDOM = 5.0
"""Degrees of freedom of the factor's logarithm."""

POINTS = 96
DISAGREES = 18.0
"""Chi square of two degrees of freedom beyond which fixes and accelerometer contradict each other (1 in 8000)."""


LARGEST = 45.0
"""Changes beyond this are less and less likely, m/s: no road crash has them, the tails of a factor do."""

WIDER = (2.0, 4.0)
"""How many times worse than it thought a guess at what clipping hides may be, where the fixes say so."""


class Change(NamedTuple):
    """A horizontal change of velocity by the accelerometer.

    Attributes
    ----------
    recorded : ndarray, shape (2,)
        From the samples as they are, m/s.
    missing : ndarray, shape (2,)
        Best estimate of what clipping hides, m/s.
    spread : float
        1 sigma of the logarithm of the factor on `missing`.
    covariance : ndarray, shape (2, 2)
        Of the rest, m²/s².
    stray : float
        1 sigma of the direction of what is missing, rad.
    turn : float
        1 sigma of the direction of the axes, rad: turns the change and leaves its size.
    """

    recorded: Floats
    missing: Floats
    spread: float
    covariance: Floats
    turn: float = 0.0
    stray: float = 0.0


class Cloud(NamedTuple):
    """Weighted points of a horizontal change of velocity.

    Attributes
    ----------
    points : ndarray, shape (k, 2)
        m/s.
    weights : ndarray, shape (k,)
        Sum 1.
    mean : ndarray, shape (2,)
        m/s, at the median of the factor; of what spreads over an arc, the middle of the arc.
    factor : float
        Median factor on what was missing.
    fused : bool
        Whether the fixes took part.
    chi2 : float
        Of the fixes against the accelerometer; 0 without.
    """

    points: Floats
    weights: Floats
    mean: Floats
    factor: float
    fused: bool
    chi2: float

    def component(self, axis: int) -> Estimate:
        """One component, m/s.

        Parameters
        ----------
        axis : int
            0 forward, 1 right (V).

        Returns
        -------
        Estimate
            Mean and 95 % interval, m/s.
        """
        return self._estimate(self.points[:, axis], float(self.mean[axis]))

    def resultant(self) -> Estimate:
        """Magnitude, m/s."""
        return self._estimate(np.hypot(*self.points.T), float(np.hypot(*self.mean)))

    def pdof(self) -> Estimate:
        """Direction the force came from, rad clockwise from straight ahead, value in (-pi, pi]."""
        x, y = -self.mean + 0.0
        value = float(np.arctan2(y, x))
        off = wrap(np.arctan2(-self.points[:, 1], -self.points[:, 0]) - value)
        spread = self._estimate(np.asarray(off), 0.0)
        return Estimate(value, value + spread.low, value + spread.high)

    def of(self, values: Floats) -> Estimate:
        """Mean and interval of any function of the points, shape (k,).

        Parameters
        ----------
        values : ndarray, shape (k,)
            One per point, in any unit.

        Returns
        -------
        Estimate
            Weighted mean and 95 % interval, in that unit.
        """
        return self._estimate(values, float(self.weights @ values))

    def reaching(self, hidden: float) -> Cloud:
        """The same where more of the same may be missing: up to `hidden`, m/s, longer; the mean stays.

        Parameters
        ----------
        hidden : float
            Largest missing part, m/s.

        Returns
        -------
        Cloud
            Its points moved along the mean by up to `hidden` and across it by up to half as much either way.
        """
        size = float(np.hypot(*self.mean))
        if hidden <= 0.0 or size < 1e-9:
            return self
        along = self.mean / size
        across = np.array([-along[1], along[0]])
        k = np.arange(1, self.weights.size + 1)
        # Golden and silver ratios: evenly spread over both, and unlike the points' own order.
        longer = np.mod(0.5 + k * 0.6180339887498949, 1.0)
        sideways = np.mod(0.5 + k * 0.4142135623730951, 1.0) - 0.5
        return self._replace(points=self.points + hidden * (np.outer(longer, along) + np.outer(sideways, across)))

    def _estimate(self, values: Floats, value: float) -> Estimate:
        low, high = quantiles(values, self.weights, (0.025, 0.975))
        return Estimate(value, min(low, value), max(high, value))


def quantiles(values: Floats, weights: Floats, at: tuple[float, ...]) -> list[float]:
    """Quantiles of weighted points, halfway through each point's weight.

    Parameters
    ----------
    values, weights : ndarray, shape (k,)
        The weights add up to 1.
    at : tuple of float
        Probabilities, 0 to 1.

    Returns
    -------
    list of float
        One per probability, in the unit of `values`.
    """
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) - 0.5 * weights[order]
    return [float(np.interp(each, share, values[order])) for each in at]


def fuse(change: Change, gps: Floats | None = None, gps_covariance: Floats | None = None) -> Cloud:
    """One distribution out of both.

    Parameters
    ----------
    change : Change
    gps : ndarray, shape (2,), optional
        Change of velocity by the fixes over the same time, same axes, m/s.
    gps_covariance : ndarray, shape (2, 2), optional

    Returns
    -------
    Cloud
        Without the fixes where they contradict the accelerometer: then one of them is wrong, and not by chance.
        But where only the guess at what clipping hides contradicts them, that guess is taken to be worse than it
        thought: what was recorded is sure, and so are the fixes.
    """
    cloud = _fused(change, gps, gps_covariance)
    for wider in WIDER if change.spread > 0.0 and gps is not None else ():
        if cloud.fused:
            break
        doubted = _fused(change._replace(spread=wider * change.spread), gps, gps_covariance)
        cloud = doubted if doubted.fused else cloud
    return cloud


def _fused(change: Change, gps: Floats | None, gps_covariance: Floats | None) -> Cloud:
    u = np.zeros(1)
    if change.spread > 0.0:
        most = np.log(max(3.0 * LARGEST / max(float(np.hypot(*change.missing)), 1e-9), np.e)) / change.spread
        u = np.linspace(-4.0, float(np.clip(most, 1.0, 7.0)), FACTORS)
    odds = -(FREEDOM + 1.0) * np.log1p(u**2 / FREEDOM)  # twice the logarithm
    factor, prior = np.exp(change.spread * u), np.exp(0.5 * odds)
    centres = change.recorded + factor[:, None] * change.missing
    prior /= 1.0 + (np.hypot(*centres.T) / LARGEST) ** 8
    d = change.recorded + change.missing
    across = np.array([-d[1], d[0]])
    turned = change.turn**2 * np.outer(across, across)
    share = change.turn**2 * float(d @ d) ** 2 / max(float(across @ (change.covariance + turned) @ across), 1e-12)
    # Size and direction of the guess have one bivariate Student's distribution: off by much in one, in the other too.
    stray = change.stray * np.sqrt((FREEDOM + u**2) / (FREEDOM + 1.0))
    aside = np.outer(factor * stray, [-change.missing[1], change.missing[0]])
    covariance = change.covariance + turned + aside[:, :, None] * aside[:, None, :]
    weights, chi2, fused = prior, 0.0, False
    if gps is not None and gps_covariance is not None:
        total = covariance + gps_covariance
        inverse, r = np.linalg.inv(total), gps - centres
        distance = np.einsum("ni,nij,nj->n", r, inverse, r)
        chi2 = float(np.min(distance - odds))
        if chi2 <= DISAGREES:
            distance += np.log(np.linalg.det(total))
            weights = prior * np.exp(-0.5 * (distance - distance.min()))
            gain = covariance @ inverse
            centres, fused = centres + np.einsum("nij,nj->ni", gain, r), True
            # Joseph's form stays positive however different both are.
            left = np.eye(2) - gain
            covariance = left @ covariance @ left.swapaxes(1, 2) + gain @ gps_covariance @ gain.swapaxes(1, 2)
    weights = weights / weights.sum()
    root = np.linalg.cholesky(0.5 * (covariance + covariance.swapaxes(1, 2)) + 1e-12 * np.eye(2))
    points = _around(centres, np.einsum("kj,nij->nki", _normal_points(), root), share).reshape(-1, 2)
    # The median of the factor: a mean would be that of its tail.
    middle = np.cumsum(weights) - 0.5 * weights
    mean = np.array([np.interp(0.5, middle, column) for column in centres.T])
    at = float(np.interp(0.5, middle, factor))
    return Cloud(points, np.repeat(weights / POINTS, POINTS), mean, at, fused, chi2)


def _around(centres: Floats, off: Floats, share: float) -> Floats:
    """Points around each centre, both (n, k, 2) and off: this share of what they are off sideways is a turn.

    Displaced along the tangent instead, an unsure direction would make the magnitude larger.
    """
    c, d = (each[..., 0] + 1j * each[..., 1] for each in (centres, off))
    size = np.maximum(np.abs(c), 1e-9)[:, None]
    local = d * np.conj(c)[:, None] / size
    turned = np.exp(1j * share * local.imag / size)
    points = c[:, None] / size * (size + local.real + 1j * (1.0 - share) * local.imag) * turned
    return np.stack((points.real, points.imag), axis=-1)


def _normal_points() -> Floats:
    """Evenly spread points of the two-dimensional normal distribution, shape (POINTS, 2), mean 0 and covariance 1.

    The additive recurrence of the plastic number (Roberts 2018), through the normal quantile, then whitened.
    """
    k = np.arange(1, POINTS + 1)
    g = 1.32471795724474602596
    uniform = np.stack((np.mod(0.5 + k / g, 1.0), np.mod(0.5 + k / g**2, 1.0)), axis=1)
    points: Floats = np.asarray(ndtri(uniform))
    points -= points.mean(axis=0)
    return points @ np.linalg.inv(np.linalg.cholesky(points.T @ points / POINTS)).T
