"""The package's public names and the files that they come from; read when a name is first used."""

from .kinds import (
    POSITION as POSITION,
    REQUIREMENTS as REQUIREMENTS,
    Allowance as Allowance,
    RequirementKind as RequirementKind,
    limit_fields as limit_fields,
    on_loops as on_loops,
    on_motions as on_motions,
    register as register,
)
from .measured import STILL as STILL, Motion as Motion, RestingLoop as RestingLoop
from .requirement import REPORT as REPORT, Reported as Reported, Requirement as Requirement
