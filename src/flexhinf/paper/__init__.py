"""The experiments of Elsa & Akbari (2014), one figure and one claim per file."""

from flexhinf.paper.reproduction import STAGES, Reproduction, reproduce
from flexhinf.paper.settings import PaperSettings

__all__ = ["STAGES", "PaperSettings", "Reproduction", "reproduce"]
