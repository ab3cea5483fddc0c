"""Estimators: the states a law needs, from the signals a robot has.

::

    Plant, noise levels ─► kalman, output_injection, stationary, modal ─► Estimator, which loop runs
    u and y of a sample ─► shell: predict and correct ─► beliefs ─► a mean, its covariance
                           └─► diagnosis ─► Diagnosis

Enter at the class of a filter, such as `UnscentedKalmanFilter`; `diagnose` says which of its answers cannot be trusted.
"""

from flexhinf.estimation.diagnosis import Diagnosis, diagnose
from flexhinf.estimation.filter import MODEL_STEP, RecursiveFilter
from flexhinf.estimation.kalman import ExtendedKalmanFilter, SigmaPoints, UnscentedKalmanFilter
from flexhinf.estimation.modal import ModalFilter
from flexhinf.estimation.output_injection import OutputInjectionObserver
from flexhinf.estimation.stationary import (
    ConstantGainBelief,
    ConstantGainFilter,
    linear_model,
    stationary_covariance,
    stationary_gain,
)

#: What a controller's file may name, beside the public names.
__all__ = [
    "MODEL_STEP",
    "ConstantGainBelief",
    "ConstantGainFilter",
    "Diagnosis",
    "ExtendedKalmanFilter",
    "ModalFilter",
    "OutputInjectionObserver",
    "RecursiveFilter",
    "SigmaPoints",
    "UnscentedKalmanFilter",
    "diagnose",
    "linear_model",
    "stationary_covariance",
    "stationary_gain",
]
