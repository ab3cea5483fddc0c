"""Laws of several degrees over what makes a robot nonlinear: the cases, and the figures of each.

The laws of a case have the same weights, γ/γ* and estimator, so the same linear part: the same bandwidth, margins and
noise at the motors. They differ far from their operating point. Each makes the step as it is deployed, with estimator
and measurement noise, on the nominal robot and on robots sampled within its tolerances, and holds a load at the goal.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

import flexhinf as fh
from flexhinf.analysis.modes import JointScales
from flexhinf.designs import Specification
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.monte_carlo import sampled_runs
from flexhinf.designs.noise_levels import EstimatorNoise
from flexhinf.designs.problem.presets import DesignProblem, choose, required_damping
from flexhinf.designs.responses import (
    LOAD_FRACTION,
    Response,
    default_load,
    sample_robots,
    worst_of,
)
from flexhinf.designs.synthesis.by_step import choose_degree, solve_degrees, step_cost, tried_degrees
from flexhinf.designs.synthesis.noise import search_noise
from flexhinf.plant import GeneralisedPlant, Law, Plant
from flexhinf.robot import Parameter, Robot
from flexhinf.robot.signals import signal_names

LAWS = {2: "linear", 4: "cubic", 6: "quintic"}
FASTER, SCHEDULED = "linear, 1.3 × bandwidth", "linear, scheduled"

#: Robot, and goal in degrees.
ROBOTS = {
    "one link, to 90°": ("paper", (90.0,)),
    "one link, to upright": ("paper", (180.0,)),
    "two links": ("planar-two-link", (90.0, 45.0)),
    "three links": ("spatial-three-link", (45.0, 45.0, 45.0)),
}

#: What is varied: the step of every joint with the law about the goal, and about the start, degrees; the largest twist
#: of a spring by the weight, rad (m g L/K); the cubic part of the springs' torque over the linear one, at the largest
#: twist in the linear law's step. The step is `STEP` degrees in the last two.
FACTORS = {
    "step": (10.0, 30.0, 60.0, 90.0, 120.0),
    "pose": (10.0, 30.0, 60.0, 90.0, 120.0),
    "gravity": (0.0, 0.05, 0.1, 0.2, 0.4),
    "hardening": (0.1, 0.3, 1.0, 3.0),
}
STEP = 60.0

#: Length of every run, s; robots within the tolerances; load over the torque that the motors give at the peak input of
#: the linear law's step; bandwidth of the faster loop over the other one's.
LENGTH, SAMPLES, LOAD, FASTER_BY = 6.0, 8, 0.5, 1.3


@dataclass(frozen=True)
class Case:
    """One robot with one number varied."""

    row: str
    factor: str
    value: float

    @property
    def text(self) -> str:
        """What is varied, for the table."""
        return {
            "step": f"step of {self.value:g}°", "pose": f"law about the start, {self.value:g}° away",
            "gravity": f"m g L/K = {self.value:g}", "hardening": f"springs of {self.value:g} cubic",
        }[self.factor]  # fmt: skip

    @property
    def goal(self) -> np.ndarray:
        """Link positions (n,), rad."""
        return np.radians(ROBOTS[self.row][1])

    @property
    def start(self) -> np.ndarray:
        """Link positions (n,), rad."""
        return self.goal - np.radians(self.value if self.factor in ("step", "pose") else STEP)

    @cached_property
    def robot(self) -> Robot:
        """With the gravity of the case; springs are as the file has them."""
        robot = fh.load_robot(ROBOTS[self.row][0])
        if self.factor != "gravity":
            return robot
        return robot.with_values({"gravity": robot.nominal["gravity"] * self.value / largest_twist(robot)})


CASES = tuple(
    Case(row, factor, value) for row in ROBOTS for factor, values in FACTORS.items() for value in values
)


def largest_twist(robot: Robot) -> float:
    """Of a spring by the weight at 200 poses, rad."""
    n = len(robot.joint_names)
    poses = np.random.default_rng(0).uniform(-1.57, 1.57, (200, n))
    states = np.array([robot.operating_point(pose)[0] for pose in poses])
    return float(np.abs(states[:, 2 * n : 3 * n] - states[:, :n]).max())


class KnownSprings(LoopSetup):
    """A loop whose estimator and law know the extras of the true plant."""

    @cached_property
    def model(self) -> Plant:
        """With the extras."""
        return self.smooth_plant

    @cached_property
    def goal_equilibrium(self) -> tuple[np.ndarray, np.ndarray]:
        """With the extras."""
        return self.equilibrium(self.goal)


@dataclass(frozen=True, eq=False)
class Study:
    """The laws of one case, and the loop that they run in."""

    case: Case
    setup: LoopSetup
    problem: GeneralisedPlant
    gamma: float

    @staticmethod
    def of(case: Case, levels: EstimatorNoise | None) -> Study:
        """With the weights of the preset damped about the operating point of the law."""
        s = Specification(
            pose=tuple(case.goal), start=tuple(case.start), preset="damped", duration=LENGTH, latency=0
        )
        chosen = choose(case.robot, case.start if case.factor == "pose" else case.goal, case.start, s)
        law = fh.solve_hji(chosen.problem, chosen.gamma, 2)
        setup = LoopSetup(case.robot, s, law, case.goal, case.start, estimator_noise=levels)
        study = Study(case, setup, chosen.problem, chosen.gamma)
        return study.hardened(chosen) if case.factor == "hardening" else study

    def hardened(self, chosen: DesignProblem) -> Study:
        """The same weights with the springs of the case, known to law and estimator."""
        n, step = len(self.case.goal), self.setup.step(LENGTH)
        x = step.run.signals["state"]
        twist = np.abs(x[:, 2 * n : 3 * n] - x[:, :n]).max(axis=0)
        stiffness = np.atleast_1d(self.case.robot.plant_parameters()["stiffness"])
        cubic = self.case.value * stiffness / twist**2
        names = [
            name.replace("link_position", "spring_hardening")
            for name in signal_names("link_position", self.setup.joints)
        ]
        robot = self.case.robot.with_parameters(*(Parameter(*pair) for pair in zip(names, cubic.tolist())))
        s = replace(self.setup.specification, extras=("spring_hardening",))
        problem = robot.problem(chosen.penalty, pose=self.case.goal, extras=s.extras)
        gamma = s.gamma_ratio * fh.smallest_gamma(problem)
        law = fh.solve_hji(problem, gamma, 2)
        known = KnownSprings(
            robot, s, law, self.case.goal, self.case.start, estimator_noise=self.setup.estimator_noise
        )
        return Study(self.case, known, problem, gamma)

    def rows(self) -> list[dict[str, Any]]:
        """Figures of every law; infinite where a run diverges or does not settle."""
        choices = tuple(
            solve_degrees(
                self.problem,
                tried_degrees(len(self.problem.state_names), self.setup.specification.degrees),
                self.gamma,
            )
        )
        laws: dict[str, Law] = {LAWS[choice.degree]: choice.solution for choice in choices}
        linear = laws["linear"]
        if self.case.factor == "pose":
            there = self._linear(1.0)
            laws[SCHEDULED] = fh.Schedule([there, linear])
        elif self.case.factor != "hardening":
            laws[FASTER] = self._linear(FASTER_BY)
        peak = np.abs(self._step(linear).inputs).max(axis=0)
        found = {name: self._figures(law, peak) for name, law in laws.items()}
        if self.case.factor != "pose":
            used, judged = choose_degree(self.setup, self.problem, choices)
            for choice in judged:
                acting = None if np.isnan(choice.acting) else choice.acting
                found[LAWS[choice.degree]] |= {"acting": acting, "used": choice is used}
        return [{**asdict(self.case), "law": name, **figures} for name, figures in found.items()]

    def _linear(self, factor: float) -> Law:
        """About the goal, of so many times the bandwidth."""
        s, case = self.setup.specification, self.case
        here = choose(case.robot, case.goal, case.start, s)
        assert here.target is not None
        faster = replace(s, bandwidth=(factor * here.target.bandwidth).tolist(), damping=here.target.damping)
        chosen = choose(case.robot, case.goal, case.start, faster, near=here)
        return fh.solve_hji(chosen.problem, chosen.gamma, 2)

    def _step(self, law: Law) -> Response:
        """The step of the nominal robot; a law about the start is commanded to the goal."""
        setup = replace(self.setup, law=law)
        if self.case.factor != "pose":
            return setup.step(LENGTH)
        names = signal_names("link_position", setup.joints)
        x, u = setup.equilibrium(self.case.start)
        run = setup.loop(setup.bumpless_controller).run(
            duration=LENGTH, reference={name: fh.Step(float(to)) for name, to in zip(names, self.case.goal)},
            noise=setup.noise, initial_state=x, initial_input=u,
        )  # fmt: skip
        return Response(run, self.case.goal, self.case.start, setup.joints)

    def _figures(self, law: Law, peak: np.ndarray) -> dict[str, Any]:
        """Of one law; `peak` (n,) are the largest inputs of the linear law's step."""
        setup, step = replace(self.setup, law=law), self._step(law)
        figures = {
            "cost": step_cost(self.problem, step, setup.equilibrium(self.case.goal)),
            "settling": step.settling.value, "overshoot": step.overshoot.value, "peak": step.peak_input,
            "noise": worst_of(step.metrics, "input_noise").value,
        }  # fmt: skip
        if self.case.factor == "pose":
            return figures
        per_input = JointScales.of(setup.model, setup.goal_equilibrium).per_input
        load = setup.load_response(LOAD / LOAD_FRACTION * default_load(per_input, peak), LENGTH)
        figures |= {
            "deviation": worst_of(load.metrics, "peak_deviation").value,
            "recovery": worst_of(load.metrics, "recovery_time_s").value,
        }
        if setup.robot.uncertain and step.diverged_at is None:
            samples = sampled_runs(
                setup, sample_robots(setup.robot, SAMPLES, 0), LENGTH, step.run.settings["sub_steps"]
            )
            figures |= {
                "worst_settling": float(samples.settling.max()),
                "worst_overshoot": float(samples.overshoot.max()),
            }
        return figures


def levels_of(row: str) -> EstimatorNoise | None:
    """The estimator's noise levels of a robot, the same in all its cases: those of its design."""
    case = Case(row, "step", STEP)
    setup = Study.of(case, None).setup
    target = choose(case.robot, case.goal, case.start, setup.specification).target
    found = search_noise(setup, required_damping(setup.specification.damping, target))
    return None if found is None else found.chosen.levels


def study(cases: Sequence[Case], file: Path) -> list[dict[str, Any]]:
    """Figures of all cases; those that the file has are not computed again."""
    file.parent.mkdir(exist_ok=True)
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    rows = [json.loads(line) for line in lines]
    known = {(row["row"], row["factor"], row["value"]) for row in rows}
    levels: dict[str, EstimatorNoise | None] = {}
    for case in track([case for case in cases if (case.row, case.factor, case.value) not in known], "cases"):
        if case.row not in levels:
            levels[case.row] = levels_of(case.row)
        more = Study.of(case, levels[case.row]).rows()
        with file.open("a", encoding="utf-8") as out:
            out.writelines(json.dumps(row) + "\n" for row in more)
        rows += more
    return rows
