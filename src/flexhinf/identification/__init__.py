"""Logs of a robot: how they are read, what a filter makes of them, the parameters that they tell.

::

    a file ─► log_reader ─► Log ─┬─► doctor ──────────────────► LogFinding
                                 ├─► filtering, smoothing ────► estimates in a table ─► consistency
                                 └─► identify, output_error ──► Identification
    Robot ─► excitation ─► a motion to record

A log is a table of times, inputs and measured signals: `read_log` reads one from a file. `filter_log` runs a filter
over it in one compiled call; `identify` finds the parameters under which the log is most likely, and says which of them
it does not tell.
"""

from flexhinf.identification.consistency import consistency
from flexhinf.identification.doctor import LogFinding, examine
from flexhinf.identification.excitation import Excitation, excitation
from flexhinf.identification.filtering import filter_log
from flexhinf.identification.identify import Identification, identify
from flexhinf.identification.log import Log
from flexhinf.identification.log_reader import read_log
from flexhinf.identification.output_error import OutputError, output_error

__all__ = [
    "Excitation",
    "Identification",
    "Log",
    "LogFinding",
    "OutputError",
    "consistency",
    "examine",
    "excitation",
    "filter_log",
    "identify",
    "output_error",
    "read_log",
]
