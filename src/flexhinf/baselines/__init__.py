"""The laws a sceptic would use, each behind `flexhinf.plant.Law`, and one way to tune them alike: `tune`.

============================  ==================================================================================
law                           when to choose it
============================  ==================================================================================
`MotorPD`                     what most elastic robots run; needs no spring model, slow where joints are soft
`TorqueFeedback`              a lighter rotor by the spring's torque; damps the vibration, stays passive
`FeedbackLinearisation`       exact and decoupled where the model is; pays with effort and needs the model
`LinearQuadratic` (`lqr`)     the problem's own weights without H∞, good near its pose
`GravityCompensatedLQR`       the same with the weight exact at every pose
============================  ==================================================================================
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "Candidate": "tuning",
    "FeedbackLinearisation": "feedback_linearisation",
    "GravityCompensatedLQR": "gravity_compensated_lqr",
    "GravityTorque": "gravity",
    "Judgement": "tuning",
    "LinearQuadratic": "linear_quadratic",
    "MotorPD": "motor_pd",
    "NormalForm": "normal_form",
    "TorqueFeedback": "torque_feedback",
    "Tuning": "tuning",
    "elastic_joints": "joints",
    "excess": "tuning",
    "lqr": "linear_quadratic",
    "lqr_gain": "linear_quadratic",
    "tune": "tuning",
}

__all__ = [
    "Candidate", "FeedbackLinearisation", "GravityCompensatedLQR", "GravityTorque", "Judgement", "LinearQuadratic",
    "MotorPD", "NormalForm", "TorqueFeedback", "Tuning", "elastic_joints", "excess", "lqr", "lqr_gain", "tune",
]  # fmt: skip

if TYPE_CHECKING:
    from flexhinf.baselines.feedback_linearisation import FeedbackLinearisation
    from flexhinf.baselines.gravity import GravityTorque
    from flexhinf.baselines.gravity_compensated_lqr import GravityCompensatedLQR
    from flexhinf.baselines.joints import elastic_joints
    from flexhinf.baselines.linear_quadratic import LinearQuadratic, lqr, lqr_gain
    from flexhinf.baselines.motor_pd import MotorPD
    from flexhinf.baselines.normal_form import NormalForm
    from flexhinf.baselines.torque_feedback import TorqueFeedback
    from flexhinf.baselines.tuning import Candidate, Judgement, Tuning, excess, tune


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.baselines' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.baselines.{_HOME[name]}"), name)
    globals()[name] = value
    return value
