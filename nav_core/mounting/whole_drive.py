"""The whole-drive estimator: the product's default answer to "how does this box sit?".

Closed-form start, then Gauss-Newton on the model of `nav_core.mounting.model` with the evidence of
both planes, robust against outliers, the lags of speed and course among the unknowns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from nav_core.mounting import closed_form
from nav_core.mounting.confidence import MIN_MOVING, Judgement, Motion, judge, motion_of, too_little
from nav_core.mounting.evidence import Fit
from nav_core.mounting.model import (
    BIAS,
    COURSE_LAG,
    SPEED_LAG,
    TURN,
    UNKNOWNS,
    Fixes,
    Noise,
    Record,
    blocks_of,
    pitch_plane,
    prepare,
    prior,
    usable_fixes,
    yaw_plane,
)
from nav_core.mounting.whitening import whiten
from nav_core.records import Gnss, MountingEstimate
from nav_core.signal import Ticks
from nav_core.typing import Floats
