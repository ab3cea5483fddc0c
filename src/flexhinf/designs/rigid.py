"""The rigid design: a law for the robot with infinitely stiff springs, tested on the elastic robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.responses import Response
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop import Controller, Loop
from flexhinf.plant import GeneralisedPlant, Penalty, Plant, ProblemLaw
from flexhinf.robot.layout import Layout
from flexhinf.robot.modes import Mode, modes_of

#: The side whose position and velocity are fed back; on a rigid robot both sides are the same.
FEEDBACK_SIDES = ("link", "motor")


def rigid_flow(elastic: Callable[..., Elements], x: Elements, u: Elements, d: Elements, p: Any) -> Elements:
    """ẋ of (M(q) + J) q̈ + C q̇ + G + B q̇ = τ + d_link + d_motor, x = (q, q̇), of any element.

    The elastic robot's equations with unloaded springs give the accelerations a_link and a_motor of links and motors.
    The rigid joint makes both move together,
    q̈ = a_motor + σ √J⁻¹ (σ + √J M⁻¹ √J)⁻¹ √J (a_link − a_motor), with the share σ of a load that moves a motor: less
    than 1 of some drives with an inner loop. A column of M⁻¹ is the change of a_link by 1 N·m on a link.

    `elastic`: the equations, without extras.
    """

    root = np.atleast_1d(np.sqrt(p.motor_inertia))
    n = len(root)
    numbers = cast("dict[str, Elements]", vars(p))
    share = np.atleast_1d(numbers.get("load_share", np.ones(n)))
    q, dq = x[:n], x[n:]

    def rates(torques: Any) -> tuple[Any, Any]:
        rate = elastic(np.concatenate([q, dq, q, dq]), u, torques, p)
        return rate[n : 2 * n], rate[3 * n : 4 * n]

    link, motor = rates(d)
    columns = [rates(d + np.eye(2 * n)[j])[0] - link for j in range(n)]
    matrix = [
        [root[i] * columns[j][i] * root[j] + (share[i] if i == j else 0.0) for j in range(n)]
        for i in range(n)
    ]
    right = list(root * (link - motor))
    for k in range(n):  # elimination without pivoting, as polynomials cannot be compared
        for i in range(k + 1, n):
            factor = matrix[i][k] / matrix[k][k]
            matrix[i] = [left - factor * above for left, above in zip(matrix[i], matrix[k])]
            right[i] = right[i] - factor * right[k]
    for k in reversed(range(n)):
        known = sum((matrix[k][j] * right[j] for j in range(k + 1, n)), start=0.0)
        right[k] = (right[k] - known) / matrix[k][k]
    return np.concatenate([dq, motor + share * np.array(right) / root])


@dataclass(frozen=True, eq=False, repr=False)
class RigidLaw(ProblemLaw):
    """The rigid robot's law on the elastic robot, fed the position and velocity of one side.

    It is a `flexhinf.plant.Law` of the elastic robot's states, with the integrals of the error on that side.
    """

    solution: HJISolution
    problem: GeneralisedPlant
    side: str

    @property
    def _places(self) -> np.ndarray:
        half, size = len(self.problem.plant.states) // 2, len(self.state_names)
        first = 0 if self.side == "link" else half
        return np.array([*range(first, first + half), *range(2 * half, size)])

    @property
    def state_names(self) -> tuple[str, ...]:
        """States of the elastic robot, then integrals on the side that is fed back."""
        tracked = [name.replace("link_position", f"{self.side}_position") for name in self.problem.integrate]
        return (*self.problem.plant.states, *(f"{name}_integral" for name in tracked))

    @property
    def law_data(self) -> np.ndarray:
        """Coefficients of the rigid law."""
        return self.solution.law_data

    @property
    def law_key(self) -> str:
        """Key of the law: side and monomials."""
        return f"rigid {self.side} {self.solution.law_key}"

    def evaluate_law(self, x: Elements, data: Any) -> Elements:
        """The rigid law of the states that are fed back."""
        return self.solution.evaluate_law(np.asarray(x)[self._places], data)

    @property
    def gain(self) -> np.ndarray:
        """Linear part of the law (m, N) on the elastic robot's states, with integrals of the side that is fed back."""
        gain = np.zeros((len(self.solution.gain), len(self.state_names)))
        gain[:, self._places] = self.solution.gain
        return gain

    def closed_loop(self) -> np.ndarray:
        """A of the elastic robot in this law's loop, (N, N)."""
        plant, n, size = self.problem.plant, self.problem.plant.n, len(self.state_names)
        a, b, _, _ = plant.linearise(self.operating_point[:n], self.operating_input)
        whole, inputs = np.zeros((size, size)), np.zeros((size, b.shape[1]))
        whole[:n, :n], inputs[:n] = a, b
        for row, name in enumerate(self.state_names[n:]):
            whole[n + row, plant.index(name.removesuffix("_integral"))] = 1.0
        return whole + inputs @ self.gain


def rigid_problem(problem: GeneralisedPlant) -> GeneralisedPlant | None:
    """The problem for the rigid robot at the same pose; None for a penalty of code, or with rigid or coupled joints.

    The squared weights of link and motor are added, as both are one state. Weights of spring torques are dropped.
    """
    plant, penalty = problem.plant, problem.penalty
    weights: Any = getattr(penalty.states, "states", None)  # of a penalty of states and torques of springs
    if not callable(penalty.states):
        weights = penalty.weights(problem.state_names)
    layout = Layout.of_plant(plant)
    if weights is None or layout.rigid or layout.coupling:
        return None
    n = plant.n // 4
    link, motor, integrals = np.split(np.asarray(weights, dtype=float), [2 * n, 4 * n])

    def positions(x: Elements, u: Elements, p: Any) -> Elements:
        return x[:n]

    rigid = Plant(
        partial(rigid_flow, plant.flow),
        positions,
        states=plant.states[: 2 * n],
        inputs=plant.inputs,
        disturbances=plant.disturbances,
        parameters=plant.parameters.values,
        units=plant.units,
    )
    weighted = Penalty((*np.hypot(link, motor), *integrals), penalty.effort)
    x, u = problem.operating_point, problem.operating_input
    if (
        "drive_stiffness" in plant.parameters.values
    ):  # a position that is commanded holds the motor, not the link
        u = u - (x[2 * n : 3 * n] - x[:n])
    return GeneralisedPlant(
        rigid,
        weighted,
        problem.integrate,
        problem.command,
        problem.disturbances,
        equilibrium=(x[: 2 * n], u),
    )


@dataclass(frozen=True, eq=False)
class RigidLoop:
    """The rigid law on the elastic robot, fed the true position and velocity of one `side`, link or motor."""

    side: str
    modes: tuple[Mode, ...]
    response: Response

    @property
    def stable(self) -> bool:
        """Whether every mode decays."""
        return all(mode.stable for mode in self.modes)


@dataclass(frozen=True, eq=False)
class RigidComparison:
    """The rigid design and its loops round the elastic robot."""

    gamma: float
    degree: int
    loops: tuple[RigidLoop, ...]


def compare_rigid(
    evaluation: LawEvaluation, problem: GeneralisedPlant, degree: int
) -> RigidComparison | None:
    """Design the same specification on the rigid model, and close the loop round the elastic robot.

    `evaluation`: of the design's own law, for its loop and its step. The rigid law gets the true state of one side,
    without estimator or noise, which favours it; its input is as late as that of the design, though nothing predicts.
    Returns None if there is no `rigid_problem`.
    """
    rigid, setup, scenario = rigid_problem(problem), evaluation.setup, evaluation.scenario
    if rigid is None or scenario is None:
        return None
    s, goal, loops = setup.specification, setup.goal, list[RigidLoop]()
    late = s.known_latency + s.unknown_samples
    solution = solve_hji(rigid, gamma=s.gamma_ratio * smallest_gamma(rigid), degree=degree)
    x, u = setup.equilibrium(setup.start)
    for side in FEEDBACK_SIDES:
        law = RigidLaw(solution, problem, side)
        rate = setup.limits.input_rate
        controller = Controller(
            law, None, s.period, setup.limits.saturated, start="bumpless", input_rate=rate
        )
        run = Loop(setup.true_plant, controller, setup.sub_steps, delay=s.period * late).run(
            duration=scenario.step_duration, initial_state=x, initial_input=u, seed=s.seed
        )
        response = Response(run, goal, x[: len(goal)], setup.joints)
        loops.append(RigidLoop(side, modes_of(law.closed_loop(), setup.joints, *evaluation.energy), response))
    return RigidComparison(solution.gamma, degree, tuple(loops))
