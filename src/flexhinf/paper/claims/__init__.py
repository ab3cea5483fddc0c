"""The paper's claims, each judged by computing."""

from __future__ import annotations

from collections.abc import Callable

from flexhinf.paper.claims.against_linear import judge_against_linear
from flexhinf.paper.claims.disturbances import judge_sine_disturbance, judge_step_disturbance
from flexhinf.paper.claims.h_infinity import judge_h_infinity
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.claims.reconstruction import judge_reconstruction
from flexhinf.paper.claims.tracking import judge_sine, judge_steps
from flexhinf.paper.claims.weights import judge_integral_weight, judge_link_weight
from flexhinf.paper.experiments import Experiments

__all__ = ["JUDGES", "Judged"]

Judge = Callable[[Experiments], Judged | list[Judged]]


def _of_bench(module: str) -> Judge:
    """A judge that needs the bench only; its module is loaded when it is asked."""

    def judge(experiments: Experiments) -> Judged:
        from importlib import import_module

        return import_module(f"flexhinf.paper.claims.{module}").judge(experiments.bench)

    judge.__name__ = f"judge_{module}"
    return judge


#: What is said while it runs, and the judge; in the order of the report.
JUDGES: tuple[tuple[str, Judge], ...] = (
    ("steps", judge_steps),
    ("NL-H∞ against L-H∞", judge_against_linear),
    ("what H∞ buys", judge_h_infinity),
    ("tracking", judge_sine),
    ("weight of x1", judge_link_weight),
    ("weight of x5", judge_integral_weight),
    ("electrical pole", _of_bench("electrical_pole")),
    ("attained gain", _of_bench("attained_gain")),
    ("tolerances", _of_bench("tolerances")),
    ("step disturbance", judge_step_disturbance),
    ("sinusoidal disturbance", judge_sine_disturbance),
    ("reconstruction", judge_reconstruction),
    ("bounds", _of_bench("bounded")),
    ("UKF against EKF", _of_bench("ukf_against_ekf")),
)
