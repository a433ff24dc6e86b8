"""Attitude: how it is carried along by measured angular rate, kept a rotation, and written as angles.

``propagation`` integrates quaternions and direction cosines, ``orthonormal`` repairs what integration has bent,
``euler_rates`` has the equations of the angles themselves and the way through gimbal lock, ``kernels`` the
compiled pieces that sequential algorithms are made of.  Conversions are in `nav_core.rotation`.

Filters: ``error_state`` (002: quaternion and bias by their errors, star tracker or directions), ``quaternion_ekf``
(000: seven states), ``vertical`` (gravity freed from the vehicle's acceleration by GPS), ``control_unit`` (000's modes,
resets and rejections around them).
"""

from nav_core.attitude.control_unit import (
    Control,
    Controlled,
    Surroundings,
    Tick,
    Tuning,
    measurement_variance,
    run_controlled,
)
from nav_core.attitude.error_state import (
    Direction,
    Estimates,
    GyroNoise,
    Start,
    StarTracker,
    estimate,
    process_noise,
    transition,
)
from nav_core.attitude.euler_rates import body_rate, euler_holding_roll, euler_rates, gimbal_sums
from nav_core.attitude.orthonormal import normalise_series, orthonormalise, orthonormalise_series, orthonormality_error
from nav_core.attitude.propagation import (
    body_rate_against,
    propagate_closed,
    propagate_cosines,
    propagate_euler,
    propagate_rk4,
    propagate_two_speed,
)
from nav_core.attitude.quaternion_ekf import QuaternionState, discretise, dynamics
from nav_core.attitude.vertical import force_at_rest, speed_and_rate, vehicle_acceleration

__all__ = [
    "Control",
    "Controlled",
    "Direction",
    "Estimates",
    "GyroNoise",
    "QuaternionState",
    "StarTracker",
    "Start",
    "Surroundings",
    "Tick",
    "Tuning",
    "body_rate",
    "body_rate_against",
    "discretise",
    "dynamics",
    "estimate",
    "euler_holding_roll",
    "euler_rates",
    "force_at_rest",
    "gimbal_sums",
    "measurement_variance",
    "normalise_series",
    "orthonormalise",
    "orthonormalise_series",
    "orthonormality_error",
    "process_noise",
    "propagate_closed",
    "propagate_cosines",
    "propagate_euler",
    "propagate_rk4",
    "propagate_two_speed",
    "run_controlled",
    "speed_and_rate",
    "transition",
    "vehicle_acceleration",
]
