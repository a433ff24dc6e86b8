"""The peer whose import warns: python-ins writes LaTeX into plain strings, which compiling it afresh complains of."""

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from pyins import earth, filters, inertial_sensor, measurements, strapdown, transform

__all__ = ["earth", "filters", "inertial_sensor", "measurements", "strapdown", "transform"]
