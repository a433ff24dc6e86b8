"""Kalman building blocks: predict, update, smooth, and check for consistency.

`predict` and `update` are one step in matrices, in Joseph's form and with a gate on the joint innovation;
`filter_record` and `smooth` run over a record, compiled; `extended` and `linearised` take nonlinear models;
`kernels` holds the compiled steps for use inside other kernels, `record_kernels` the filter and smoother made of them.
"""

from nav_core.kalman.consistency import Consistency, consistency, gate, mean_band, normalised
from nav_core.kalman.linear import (
    Filtered,
    State,
    Update,
    decorrelated,
    filter_record,
    joseph,
    predict,
    smooth,
    update,
)
from nav_core.kalman.nonlinear import ContinuousModel, Model, Observation, Step, extended, jacobian, linearised

__all__ = [
    "Consistency",
    "ContinuousModel",
    "Filtered",
    "Model",
    "Observation",
    "State",
    "Step",
    "Update",
    "consistency",
    "decorrelated",
    "extended",
    "filter_record",
    "gate",
    "jacobian",
    "joseph",
    "linearised",
    "mean_band",
    "normalised",
    "predict",
    "smooth",
    "update",
]
