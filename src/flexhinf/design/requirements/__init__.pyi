"""The package's public names and the files that they come from; read when a name is first used."""

from .kinds import (
    POSITION as POSITION,
    REQUIREMENTS as REQUIREMENTS,
    Allowance as Allowance,
    Motion as Motion,
    RequirementKind as RequirementKind,
    on_loops as on_loops,
    on_motions as on_motions,
    register as register,
)
from .requirement import Reported as Reported, Requirement as Requirement
