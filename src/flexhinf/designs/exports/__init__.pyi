"""The package's public names and the files that they come from; read when a name is first used."""

from .kinds import (
    EXPORTS as EXPORTS,
    Exported as Exported,
    ExportKind as ExportKind,
    register as register,
)
