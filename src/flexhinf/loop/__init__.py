"""Closed loops in simulation: enter at `Loop`, which runs a `Controller` on a true plant and returns a `Trajectory`.

`controller/` is what a real-time system would run: law, estimator, integrals, limits, one compiled step.
`signals/` are commands, disturbances and noise. `simulation/` integrates the true plant and has the metrics.
"""

from flexhinf.loop.controller.controller import Controller, load_controller
from flexhinf.loop.controller.step import Schedule
from flexhinf.loop.signals.motions import JerkLimited, Spline, Waypoints
from flexhinf.loop.signals.references import Constant, Moving, Quintic, Samples, Signal, Sine, Step
from flexhinf.loop.simulation.closed_loop import Loop
from flexhinf.loop.simulation.ensemble import Ensemble, EnsembleResult
from flexhinf.loop.simulation.metrics import (
    Instant,
    Reduction,
    load_metrics,
    step_metrics,
    step_shape,
)
from flexhinf.loop.simulation.trajectory import Trajectory
from flexhinf.plant import BlackBox
