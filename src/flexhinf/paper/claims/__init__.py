"""The paper's claims and our own questions, each judged by computing: first the criterion, then the verdict."""

from __future__ import annotations

from collections.abc import Callable

from flexhinf.paper.claims import attained_gain, bounded, electrical_pole, tolerances, ukf_against_ekf
from flexhinf.paper.claims.attained_gain import judge_sine_disturbance, judge_step_disturbance
from flexhinf.paper.claims.bounded import judge_reconstruction
from flexhinf.paper.claims.judgement import Judged
from flexhinf.paper.claims.weights import (
    judge_about_goal,
    judge_against_linear,
    judge_integral_weight,
    judge_link_weight,
    judge_sine,
    judge_steps,
)
from flexhinf.paper.claims.what_h_infinity_buys import judge_h_infinity
from flexhinf.paper.experiments import Experiments
from flexhinf.paper.loop_setup import PaperSetup

__all__ = ["JUDGES", "Judged"]

Judge = Callable[[Experiments], Judged | list[Judged]]


def _from_setup(judge: Callable[[PaperSetup], Judged]) -> Judge:
    """A judge that needs no run of the figures."""
    return lambda experiments: judge(experiments.setup)


#: What the progress bar says while it runs, and the judge; in the order of the report.
JUDGES: tuple[tuple[str, Judge], ...] = (
    ("steps", judge_steps),
    ("NL-H∞ against L-H∞", judge_against_linear),
    ("tracking", judge_sine),
    ("weight of x1", judge_link_weight),
    ("weight of x5", judge_integral_weight),
    ("electrical pole", _from_setup(electrical_pole.judge)),
    ("attained gain", _from_setup(attained_gain.judge)),
    ("tolerances", _from_setup(tolerances.judge)),
    ("step disturbance", judge_step_disturbance),
    ("sinusoidal disturbance", judge_sine_disturbance),
    ("reconstruction", judge_reconstruction),
    ("bounds", _from_setup(bounded.judge)),
    ("UKF against EKF", _from_setup(ukf_against_ekf.judge)),
    ("what H∞ buys", judge_h_infinity),
    ("laws about the goal", judge_about_goal),
)
