"""The corridor from a robot to a judged law: one call per arrow."""

from flexhinf.design.degrees import DegreeChoice, shrinking, try_degrees

__all__ = ["DegreeChoice", "shrinking", "try_degrees"]
