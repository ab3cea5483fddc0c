"""What is wrong with a log, or doubtful, before any model is blamed.

A finding is a sentence with its severity, its place and what to do (`finding`). Checks of the values of a signal
(`values`, `jumps`), of the times (`times`), of the sizes of columns (`scales`) and of the model's likelihood
(`beside_model`) stand in one list (`examination`), which every command that reads a log prints.
"""

from flexhinf.identification.doctor.examination import CHECKS, examine
from flexhinf.identification.doctor.finding import LogFinding, refuse_unusable

__all__ = ["CHECKS", "LogFinding", "examine", "refuse_unusable"]
