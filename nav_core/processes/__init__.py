"""Linear stochastic processes: transition matrices, discrete noise, correlated noise, augmentation.

A process is ``x' = F x + G w`` with white `w` of spectral density `Q` (000 eq. 3.4.2); over a step `dt` it becomes
``x(k+1) = Phi x(k) + w(k)`` with ``E[w(k) w(k)'] = Q`` (000 eqs. 3.6.17, 3.6.28).  Four ways lead to `Phi` and to
the noise: the truncated series, the inverse Laplace transform of the resolvent, the matrix exponential (with it
Van Loan's integral of the noise), and for the common processes a closed form.
"""

from nav_core.processes.augmentation import Augmented, ShapingFilter, augment, sample_path, stack
from nav_core.processes.models import (
    Process,
    gauss_markov,
    gauss_markov_covariance,
    gauss_markov_discrete,
    integrators,
    position_velocity,
    position_velocity_acceleration,
    position_velocity_acceleration_discrete,
    position_velocity_discrete,
    random_walk,
    spring,
)
from nav_core.processes.transition import (
    Discrete,
    evolve,
    first_order_noise,
    input_matrix,
    transition,
    transition_laplace,
    transition_series,
    transition_varying,
    van_loan,
)

__all__ = [
    "Augmented",
    "Discrete",
    "Process",
    "ShapingFilter",
    "augment",
    "evolve",
    "first_order_noise",
    "gauss_markov",
    "gauss_markov_covariance",
    "gauss_markov_discrete",
    "input_matrix",
    "integrators",
    "position_velocity",
    "position_velocity_acceleration",
    "position_velocity_acceleration_discrete",
    "position_velocity_discrete",
    "random_walk",
    "sample_path",
    "spring",
    "stack",
    "transition",
    "transition_laplace",
    "transition_series",
    "transition_varying",
    "van_loan",
]
