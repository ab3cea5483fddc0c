"""The room's public names and the files that they come from; read when a name is first used."""

from .equilibrium_law import (
    GravityCompensatedLQR as GravityCompensatedLQR,
    GravityTorque as GravityTorque,
    LinearQuadratic as LinearQuadratic,
    elastic_joints as elastic_joints,
    lqr as lqr,
    lqr_gain as lqr_gain,
)
from .feedback_linearisation import FeedbackLinearisation as FeedbackLinearisation, NormalForm as NormalForm
from .torque_feedback import MotorPD as MotorPD, TorqueFeedback as TorqueFeedback
from .tuning import (
    Candidate as Candidate,
    Judgement as Judgement,
    Tuning as Tuning,
    excess as excess,
    tune as tune,
)
