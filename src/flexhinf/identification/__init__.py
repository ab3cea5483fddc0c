"""Logs of a robot: what a filter makes of them, and the parameters that they tell.

A log is a table of times, inputs and measured signals. `filter_log` runs a filter over it in one compiled call;
`identify` finds the parameters under which the log is most likely, and says which of them it does not tell.
"""

from flexhinf.identification.filtering import filter_log

__all__ = ["filter_log"]
