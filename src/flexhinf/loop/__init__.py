"""Closed loops: commands and disturbances, sampling, controller, trajectory, figures of merit."""

from flexhinf.loop.black_box import BlackBox
from flexhinf.loop.closed_loop import Loop
from flexhinf.loop.controller import Controller
from flexhinf.loop.references import Constant, Quintic, Samples, Signal, Sine, Step
from flexhinf.loop.trajectory import Trajectory

__all__ = [
    "BlackBox",
    "Constant",
    "Controller",
    "Loop",
    "Quintic",
    "Samples",
    "Signal",
    "Sine",
    "Step",
    "Trajectory",
]
