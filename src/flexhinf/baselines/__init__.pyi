"""The room's public names and the files that they come from; read when a name is first used."""

from .equilibrium_law import (
    GravityCompensatedLQR as GravityCompensatedLQR,
    LinearQuadratic as LinearQuadratic,
    lqr as lqr,
    lqr_gain as lqr_gain,
)
from .placed_laws import (
    FeedbackLinearisation as FeedbackLinearisation,
    MotorPD as MotorPD,
    NormalForm as NormalForm,
    TorqueFeedback as TorqueFeedback,
)
