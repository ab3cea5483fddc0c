"""The experiments of Elsa & Akbari (2014), one figure and one claim per file."""

from flexhinf.paper.loop_setup import PaperSettings
from flexhinf.paper.reproduction import STAGES, Reproduction, reproduce

__all__ = ["STAGES", "PaperSettings", "Reproduction", "reproduce"]
