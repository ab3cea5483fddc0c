"""The package's public names and the files that they come from; read when a name is first used."""

from .kinds import (
    LAWS as LAWS,
    MODAL as MODAL,
    NL_HINF as NL_HINF,
    LawKind as LawKind,
    LawOver as LawOver,
    check_drive as check_drive,
    law_kind as law_kind,
    register as register,
    serving as serving,
)
from .pose_model import PoseModel as PoseModel
