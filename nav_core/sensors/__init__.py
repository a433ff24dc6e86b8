"""Sensors: what they make of the truth, their noise, rest, calibration and compensation.

========================  ==================================================================================
`error_model`             bias, scale, misalignment, nonlinearity, temperature, dead zone, quantisation, clipping
`noise`                   N, B, K, Q coefficients and samples that have them; published coefficients
`allan`                   overlapping Allan deviation
`identification`          coefficients with intervals; confidence of the curve
`statics`                 rest and motion; poses; turn-on bias
`calibration`             the result of a calibration, and the least squares behind it
`positions`               accelerometer, or gyro on a turntable, from the magnitude of the input: 6, 9, 18, 39 positions
`reference`               twelve parameters against a reference attitude
`magnetometer`            hard and soft iron
`temperature`             bias against temperature
`compensation`            all of it at work, with the bias that a filter feeds back
`cutoff`, `grades`        choice of a low-pass filter; performance classes and CEP rate
========================  ==================================================================================
"""

from nav_core.sensors.allan import AllanDeviation, allan_deviation, cluster_factors
from nav_core.sensors.calibration import Calibration, Poses
from nav_core.sensors.compensation import Compensation
from nav_core.sensors.cutoff import MPU6050_FILTERS, CutoffChoice, LowPass, choose_cutoff
from nav_core.sensors.error_model import REFERENCE_TEMPERATURE, SensorErrors
from nav_core.sensors.grades import cep_radius, cep_rate, gyro_grade, performance
from nav_core.sensors.identification import NoiseFit, confidence, equivalent_freedom, identify
from nav_core.sensors.magnetometer import FieldCalibration, calibrate_field
from nav_core.sensors.noise import (
    HMC5883L,
    MPU6050_ACCELEROMETER,
    MPU6050_GYRO,
    NoiseCoefficients,
    flicker,
    simulate_noise,
)
from nav_core.sensors.positions import calibrate_positions, eighteen_directions, six_positions
from nav_core.sensors.reference import calibrate_reference, reference_rates, reference_vectors
from nav_core.sensors.statics import Means, TurnOnBias, interval_means, moving_spread, static_intervals, turn_on_bias
from nav_core.sensors.temperature import TemperatureFit, fit_temperature

__all__ = [
    "HMC5883L",
    "MPU6050_ACCELEROMETER",
    "MPU6050_FILTERS",
    "MPU6050_GYRO",
    "REFERENCE_TEMPERATURE",
    "AllanDeviation",
    "Calibration",
    "Compensation",
    "CutoffChoice",
    "FieldCalibration",
    "LowPass",
    "Means",
    "NoiseCoefficients",
    "NoiseFit",
    "Poses",
    "SensorErrors",
    "TemperatureFit",
    "TurnOnBias",
    "allan_deviation",
    "calibrate_field",
    "calibrate_positions",
    "calibrate_reference",
    "cep_radius",
    "cep_rate",
    "choose_cutoff",
    "cluster_factors",
    "confidence",
    "eighteen_directions",
    "equivalent_freedom",
    "fit_temperature",
    "flicker",
    "gyro_grade",
    "identify",
    "interval_means",
    "moving_spread",
    "performance",
    "reference_rates",
    "reference_vectors",
    "simulate_noise",
    "six_positions",
    "static_intervals",
    "turn_on_bias",
]
