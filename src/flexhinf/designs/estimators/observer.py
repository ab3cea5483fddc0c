"""An observer whose output injection has the gain of the goal."""

from __future__ import annotations

from flexhinf.designs.estimators.kinds import EstimatorKind, EstimatorTask, register
from flexhinf.designs.specification import ESTIMATED_BY
from flexhinf.estimation import OutputInjectionObserver


def _observer(task: EstimatorTask) -> OutputInjectionObserver:
    numbers = task.process_noise, task.measurement_noise, task.mean, task.covariance
    return OutputInjectionObserver(task.model, task.period, *numbers, about=task.goal)


register(EstimatorKind("observer", ESTIMATED_BY["observer"], _observer, about_pose=True))
