"""Closed loops: commands and disturbances, sampling, controller, trajectory, figures of merit."""

from flexhinf.loop.black_box import BlackBox
from flexhinf.loop.closed_loop import Loop
from flexhinf.loop.controller import Controller
from flexhinf.loop.jerk_limited import JerkLimited
from flexhinf.loop.moving import Moving
from flexhinf.loop.references import Constant, Quintic, Samples, Signal, Sine, Step
from flexhinf.loop.schedule import Schedule
from flexhinf.loop.spline import Spline
from flexhinf.loop.trajectory import Trajectory

__all__ = [
    "BlackBox",
    "Constant",
    "Controller",
    "JerkLimited",
    "Loop",
    "Moving",
    "Quintic",
    "Samples",
    "Schedule",
    "Signal",
    "Sine",
    "Spline",
    "Step",
    "Trajectory",
]
