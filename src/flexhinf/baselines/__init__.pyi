"""The room's public names and the files that they come from; read when a name is first used."""

from .equilibrium_law import GravityCompensatedLQR as GravityCompensatedLQR
from .equilibrium_law import GravityTorque as GravityTorque
from .equilibrium_law import LinearQuadratic as LinearQuadratic
from .equilibrium_law import elastic_joints as elastic_joints
from .equilibrium_law import lqr as lqr
from .equilibrium_law import lqr_gain as lqr_gain
from .feedback_linearisation import FeedbackLinearisation as FeedbackLinearisation
from .feedback_linearisation import NormalForm as NormalForm
from .torque_feedback import MotorPD as MotorPD
from .torque_feedback import TorqueFeedback as TorqueFeedback
from .tuning import Candidate as Candidate
from .tuning import Judgement as Judgement
from .tuning import Tuning as Tuning
from .tuning import excess as excess
from .tuning import tune as tune
