"""Designs, a comparison and a proof whose reports are read: made once, with few tolerances, so that they are fast."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.certify.starts import limit_slice, proved_steps, start_surface, worst_step
from flexhinf.designs import Comparison, PoseEvidence, Specification, compare, design
from flexhinf.designs.certification import CertifiedDegree, Evidence
from flexhinf.designs.synthesis.by_step import DegreeChoice


def with_evaluation(design: PoseEvidence, **parts: object) -> PoseEvidence:
    """The same design with other parts of its evaluation."""
    evaluation = dataclasses.replace(design.evaluation)
    vars(evaluation).update({**vars(design.evaluation), **parts})
    return dataclasses.replace(design, evaluation=evaluation)


@pytest.fixture(scope="session")
def report_design(
    robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]
) -> Callable[[str], PoseEvidence]:
    """By what is special about it."""
    half_turn = {"pose": "90deg", "start": "0", "draws": 16, "degrees": (2, 4)}
    noise = {"torque_noise": 1e-5}
    cases: dict[str, tuple[str, tuple[str, ...], dict[str, Any]]] = {
        "met": (
            "paper", ("stiffness", "friction"),
            {**half_turn, "rays": 50, "bandwidth": 3.0, "damping": 0.2, "peak_effort": 60.0},
        ),
        "rings": (
            "paper", ("stiffness", "friction", "mass"),
            {**noise, "preset": "paper", "rays": 0, "degrees": (2,), "draws": 3, "duration": 4.0},
        ),
        "robust": (
            "paper", ("stiffness", "friction"),
            {**noise, "preset": "robust", "rays": 0, "degrees": (2,), "draws": 2},
        ),
        "cart": (
            "cart", ("stiffness_belt", "stiffness_arm"),
            {
                **noise, "measured": ("motor_position", "joint_torque"), "estimator": "ekf", "saturation": 300.0,
                "degrees": (2,), "rays": 0, "draws": 4, "bandwidth": 3.0,
            },
        ),
        "true state": (
            "quanser-rotflex", (),
            {"estimator": "none", "degrees": (2,), "rays": 20, "draws": 0},
        ),
    }  # fmt: skip
    made: dict[str, PoseEvidence] = {}

    def of(name: str) -> PoseEvidence:
        if name not in made:
            robot, uncertain, options = cases[name]
            with pytest.MonkeyPatch.context() as patch:  # "met" in 6 s instead of 8 s
                patch.setenv("FLEXHINF_OPTIMISATION", "0")
                made[name] = design(
                    only_uncertain(robot_of(robot), *uncertain), Specification(**{"pose": "home", **options})
                ).evidence
        return made[name]

    return of


@pytest.fixture(scope="session")
def report_comparison(robot_of: Callable[[str], Any], only_uncertain: Callable[..., Any]) -> Comparison:
    """Nonlinear H∞ and two PD laws, of which one is stated, a step of 0.3 rad."""
    robot = only_uncertain(robot_of("paper"), "stiffness", "friction")
    s = Specification(
        pose=[math.pi / 2], start=[math.pi / 2 - 0.3], preset="damped", bandwidth=3.0, damping=0.2,
        torque_noise=1e-5, degrees=(2,), rays=0, draws=2, duration=3.0,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:  # how laws are tuned is tested elsewhere
        patch.setenv("FLEXHINF_OPTIMISATION", "0")
        return compare(
            robot, s, ["pd", "pid"], gains={"pd": {"kp": 0.4, "kd": 0.1}, "pid": {"bandwidth": 5.0}}
        )


#: Weights of a law about upright, and those of the penalty whose gain is proved.
WEIGHTS, CHECKED_PENALTY = (75.0, 27.0, 90.0, 27.0, 330.0), np.array([60.0, 0.0, 0.0, 0.0, 300.0])


@pytest.fixture(scope="session")
def proved_degree() -> CertifiedDegree:
    """A quadratic V about upright, proved."""
    problem = fh.paper_arm().problem(fh.Penalty(WEIGHTS, effort=10.0), pose=(np.pi,))
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=2)
    given = solution.certify(1.6 * star, CHECKED_PENALTY, level=1.0e4)
    choice = DegreeChoice(2, solution, 0.0, 0.0, 0.0, 1.1e4, 1.5, "inequality", True)
    return CertifiedDegree(choice, True, given, proved_steps(solution, given), "", 0.1)


@pytest.fixture(scope="session")
def evidence(proved_degree: CertifiedDegree) -> Evidence:
    """Its pictures, without a search for a disturbance."""
    given, solution = proved_degree.certificate, proved_degree.choice.solution
    assert given is not None
    worst = (worst_step(solution, given, given.starts[1]),)
    slices = start_surface(solution, given, CHECKED_PENALTY), limit_slice(solution, given, CHECKED_PENALTY)
    return Evidence(replace(given, sampled_level=1.1e4), *slices, worst, None)
