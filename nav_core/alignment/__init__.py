"""Attitude of a box before any filter runs: levelling, gyrocompassing, and gravity with the magnetic field.

`level` needs rest and an accelerometer and knows no heading.  `gyrocompass` adds the heading where the gyros know the
Earth's turning, and says so where they do not.  With a magnetometer, `master_slave` needs no start and no strength of
the field and lets gravity rule: for alignment and after a reset (000 section 7.6.3).  `gauss_newton` weights both and
takes either's error: for use in motion, where gravity is disturbed.  `wahba` is the same for any set of directions;
`triad` is the master-slave idea for any two.  `align` looks for rest in a recording and does what its sensors allow.
`check_level` and `orientations` are the installation by hand.
"""

from nav_core.alignment.directions import Attitude, WahbaFit, triad, wahba
from nav_core.alignment.levelling import Gyrocompass, Levelling, gyrocompass, level, mean_sigma, tilt
from nav_core.alignment.magnetic import GaussNewtonFit, gauss_newton, master_slave
from nav_core.alignment.recording import Alignment, Place, Trust, align, longest_rest
from nav_core.by_hand import LevelCheck, check_level, largest_tilt, levelled, orientations, tilt_errors

__all__ = [
    "Alignment",
    "Attitude",
    "GaussNewtonFit",
    "Gyrocompass",
    "LevelCheck",
    "Levelling",
    "Place",
    "Trust",
    "WahbaFit",
    "align",
    "check_level",
    "gauss_newton",
    "gyrocompass",
    "largest_tilt",
    "level",
    "levelled",
    "longest_rest",
    "master_slave",
    "mean_sigma",
    "orientations",
    "tilt",
    "tilt_errors",
    "triad",
    "wahba",
]
