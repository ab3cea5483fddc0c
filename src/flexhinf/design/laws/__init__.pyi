"""The package's public names and the files that they come from; read when a name is first used."""

from .factory import LawFactory as LawFactory, weighted as weighted
from .kinds import (
    CHANNELS as CHANNELS,
    CONTAINED as CONTAINED,
    DEGREE as DEGREE,
    DESIGN as DESIGN,
    ESTIMATOR_NOISE as ESTIMATOR_NOISE,
    IN_USE as IN_USE,
    INFINITE_GAMMA as INFINITE_GAMMA,
    LARGEST_DEGREE as LARGEST_DEGREE,
    LAWS as LAWS,
    LINEAR_QUADRATIC as LINEAR_QUADRATIC,
    MOTOR_NOISE as MOTOR_NOISE,
    NL_HINF as NL_HINF,
    NO_CHANNELS as NO_CHANNELS,
    NO_VELOCITY as NO_VELOCITY,
    ROBUST as ROBUST,
    LawKind as LawKind,
    LawOver as LawOver,
    TuningParameter as TuningParameter,
    check_drive as check_drive,
    is_hinf as is_hinf,
    law_kind as law_kind,
    law_names as law_names,
    laws_over as laws_over,
    register as register,
    rivals as rivals,
)
from .pose_model import PoseModel as PoseModel
