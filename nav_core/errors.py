"""The errors that `nav_core` raises; each carries the numbers that explain it.

::

    NavigationError
    ├── ShapeError          an array has the wrong shape
    ├── NotFiniteError      a value is NaN or infinite where a number is needed
    ├── OrderError          times do not increase
    ├── RangeError          a value lies outside what has a meaning
    ├── TooLittleDataError  fewer samples than the method needs
    ├── ConstantError       samples that do not change, where their noise is asked for
    ├── PosesError          the poses of a calibration do not determine its parameters
    ├── CovarianceError     a covariance is not positive definite
    ├── GeometryError       the satellites do not span the unknowns
    └── ConvergenceError    an iteration does not settle
"""

from __future__ import annotations


class NavigationError(ValueError):
    """Base of all errors raised by `nav_core`."""


class ShapeError(NavigationError):
    """An array has the wrong shape."""

    def __init__(self, name: str, shape: tuple[int, ...], expected: str) -> None:
        self.name, self.shape, self.expected = name, shape, expected
        super().__init__(f"{name} has shape {shape}, expected {expected}")


class NotFiniteError(NavigationError):
    """A value is NaN or infinite where a number is needed."""

    def __init__(self, name: str, index: int) -> None:
        self.name, self.index = name, index
        super().__init__(f"{name} is not finite at index {index}")


class OrderError(NavigationError):
    """Times do not increase strictly."""

    def __init__(self, name: str, index: int) -> None:
        self.name, self.index = name, index
        super().__init__(f"{name} does not increase at index {index}")


class RangeError(NavigationError):
    """A value lies outside the range in which it has a meaning."""

    def __init__(self, name: str, value: float, expected: str) -> None:
        self.name, self.value, self.expected = name, value, expected
        super().__init__(f"{name} is {value:g}, expected {expected}")


class TooLittleDataError(NavigationError):
    """Fewer samples than the method needs."""

    def __init__(self, name: str, count: int, needed: int) -> None:
        self.name, self.count, self.needed = name, count, needed
        super().__init__(f"{name}: {count} samples, at least {needed} needed")


class ConstantError(NavigationError):
    """Samples that do not change, where their noise is asked for."""

    def __init__(self, name: str, factor: int) -> None:
        self.name, self.factor = name, factor
        super().__init__(f"{name} repeats itself: all means over {factor} samples are alike, and no noise shows")


class PosesError(NavigationError):
    """The poses of a calibration do not determine its parameters."""

    def __init__(self, reason: str, count: int, condition: float) -> None:
        self.reason, self.count, self.condition = reason, count, condition
        super().__init__(f"{count} poses do not suffice: {reason}")


class CovarianceError(NavigationError):
    """A covariance that must be positive definite is not."""

    def __init__(self, name: str, smallest: float) -> None:
        self.name, self.smallest = name, smallest
        super().__init__(f"{name} is not positive definite: its smallest eigenvalue is {smallest:g}")


class GeometryError(NavigationError):
    """The satellites do not span the unknowns."""

    def __init__(self, condition: float) -> None:
        self.condition = condition
        super().__init__(f"the satellites' geometry leaves a direction open (condition number {condition:.3g})")


class ConvergenceError(NavigationError):
    """An iteration does not settle."""

    def __init__(self, rounds: int, step: float) -> None:
        self.rounds, self.step = rounds, step
        super().__init__(f"no solution after {rounds} rounds: the last step is {step:.3g} m")
