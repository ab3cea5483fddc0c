"""Closed loops in simulation: enter at `Loop`, whose run of a `Controller` on a true plant is a `Trajectory`.

::

    Law, Estimator, its limits ─► controller ─┐
    commands and disturbances ──► signals ────┼─► simulation ─┬─► Trajectory, its metrics
    a true plant ─────────────────────────────┘               └─► Ensemble: many plants, their metrics alone

`controller/` is the part that a real-time system runs: law, estimator, integrals, limits, one compiled step. `signals/`
are commands and disturbances. `simulation/` samples them, integrates the true plant and has the metrics.
"""

from flexhinf.loop.controller.backlash import Backlash as Backlash
from flexhinf.loop.controller.controller import Controller as Controller, load_controller as load_controller
from flexhinf.loop.controller.friction import DryFriction as DryFriction
from flexhinf.loop.controller.governor import Governor as Governor
from flexhinf.loop.controller.keywords import ControllerOptions as ControllerOptions
from flexhinf.loop.controller.laws import Schedule as Schedule, savable_estimator as savable_estimator
from flexhinf.loop.controller.protection import Protection as Protection
from flexhinf.loop.controller.status import Status as Status, Supervision as Supervision
from flexhinf.loop.signals.motions import JerkLimited as JerkLimited, Spline as Spline, Waypoints as Waypoints
from flexhinf.loop.signals.references import (
    Braked as Braked,
    Constant as Constant,
    Moving as Moving,
    Quintic as Quintic,
    Samples as Samples,
    Signal as Signal,
    Sine as Sine,
    Step as Step,
)
from flexhinf.loop.simulation.closed_loop import Loop as Loop
from flexhinf.loop.simulation.ensemble import Ensemble as Ensemble, EnsembleResult as EnsembleResult
from flexhinf.loop.simulation.metrics import (
    Instant as Instant,
    Reduction as Reduction,
    load_metrics as load_metrics,
    step_metrics as step_metrics,
    step_shape as step_shape,
)
from flexhinf.loop.simulation.trajectory import Trajectory as Trajectory
from flexhinf.plant import BlackBox as BlackBox
from flexhinf.starts import Start as Start
from flexhinf.stops import Stop as Stop
