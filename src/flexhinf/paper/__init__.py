"""The experiments of Elsa & Akbari (2014): runs, claims with their criteria, and a verdict for each."""

from flexhinf.paper.loop_setup import PaperSettings
from flexhinf.paper.reproduction import STAGES, Reproduction, reproduce

__all__ = ["STAGES", "PaperSettings", "Reproduction", "reproduce"]
