"""The room's public names and the files that they come from; read when a name is first used."""

from .reproduction import STAGES as STAGES, Reproduction as Reproduction, reproduce as reproduce
from .settings import PaperSettings as PaperSettings
