"""The linearised loop of a law with its estimator, at rest at the goal: damping, margins, noise, unstable corners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.analysis import EquilibriumLoop, corner_population, margins
from flexhinf.analysis.linear_loop import LinearLoop
from flexhinf.design.bench import Bench
from flexhinf.design.compare.runs import integrates
from flexhinf.design.modes import named_modes
from flexhinf.errors import NumericalFailure
from flexhinf.plant import Law

__all__ = ["Linear", "bandwidth_of", "corners_of", "linear_bench", "linear_figures", "sensitivity_at_rest"]

#: Corners of the tolerances, for up to so many states, and with more.
CORNERS = ((15, 400), (10_000, 60))

#: Extras that are smooth at rest; the others are left out of the linearisation.
SMOOTH = ("inductance", "joint_damping", "spring_hardening")


@dataclass(frozen=True, eq=False)
class Linear:
    """Figures of one linearised loop.

    Attributes
    ----------
    stable : bool
    damping : float or None
        Smallest of a vibration; None where nothing vibrates.
    delay_margin : float
        Beyond the delay of the specification, s; infinite if no delay makes it unstable.
    peak_sensitivity : float
    input_noise : float
        RMS of the noisiest input for the specification's measurement noise, V or N·m.
    bandwidth : float
        Of the slowest joint, rad/s: |command → link position| as the law is commanded, the definition of
        ``flexhinf design``; NaN for an unstable loop.
    unstable, corners : int
        Of the corners of the tolerances.
    """

    stable: bool
    damping: float | None
    delay_margin: float
    peak_sensitivity: float
    input_noise: float
    bandwidth: float
    unstable: int
    corners: int


def linear_bench(bench: Bench) -> Bench:
    """The bench without extras that are not smooth at rest."""
    s = bench.specification
    smooth = tuple(name for name in s.extras if name in SMOOTH)
    return replace(bench, specification=replace(s, extras=smooth))


def resting_loop(bench: Bench, law: Law) -> EquilibriumLoop:
    """The sampled loop of a law about the goal, as the law is commanded.

    A command goes through the integrals of a law that has some; for one without, x_d(q) and u_d(q) are moved.
    """
    bench = linear_bench(bench)
    s, rest = bench.specification, bench.robot.operating_point(bench.goal)
    joints = bench.model.states[: len(bench.goal)]
    return EquilibriumLoop(
        law, bench.estimator(bench.goal), bench.true_plant, s.period, equilibrium=rest, moving=not integrates(law),
        delay=round(s.delay / s.period), positions=joints,
    )  # fmt: skip


def bandwidth_of(bench: Bench, law: Law) -> float:
    """Of the slowest joint, rad/s; infinite for an unstable loop: nothing to tune to."""
    found = margins(resting_loop(bench, law))
    return float(found.bandwidth.min()) if found.stable else np.inf


def sensitivity_at_rest(bench: Bench, law: Law) -> float:
    """Peak sensitivity of the linearised loop with its estimator at the goal; infinite for an unstable one.

    Infinite too where no equilibrium is found: a loop that cannot be linearised is not known to be robust.
    """
    try:
        return margins(resting_loop(bench, law)).peak_sensitivity
    except NumericalFailure:
        return np.inf


def linear_figures(
    bench: Bench, law: Law, energy: tuple[np.ndarray, np.ndarray], corners: Sequence[Mapping[str, Any]]
) -> Linear:
    """All of them; an unstable loop has no margins.

    Parameters
    ----------
    bench : Bench
    law : Law
    energy : (stiffness, inertia)
        See `flexhinf.design.modes.named_modes`.
    corners : sequence of mapping
        Parameters of the true plants.

    Raises
    ------
    FlexhinfError
        If the loop has no rest that it could be linearised at.
    """
    loop = resting_loop(bench, law)
    linear = loop.linear()
    found, rms = margins(linear), np.inf
    if found.stable:
        noise = np.zeros(len(linear.c)) if bench.noise is None else bench.noise
        rms = float(np.linalg.norm(found.noise_to_input * noise, axis=1).max())
    unstable = int((loop.modes(corners).rate >= 0.0).sum()) if corners else 0
    return Linear(
        found.stable,
        _damping(linear, bench.robot.joint_names, energy),
        found.delay_margin_s,
        found.peak_sensitivity,
        rms,
        float(found.bandwidth.min()),
        unstable,
        len(corners),
    )


def corners_of(bench: Bench, states: int) -> list[Mapping[str, Any]]:
    """Corners of the tolerances as parameters of the true plant, each tolerance alone, and the nominal robot."""
    robot, table = bench.robot, linear_bench(bench).true_plant.parameters
    if not robot.uncertain:
        return []
    count = next(count for most, count in CORNERS if states <= most)

    def at(signs: Sequence[float]) -> dict[str, Any]:
        return table.known(robot.corner(signs))

    return list(corner_population(at, len(robot.uncertain), count, bench.specification.seed).values)


def _damping(
    linear: LinearLoop, joints: Sequence[str], energy: tuple[np.ndarray, np.ndarray]
) -> float | None:
    """Smallest damping ratio of a vibration of the whole sampled loop, estimator and delay included."""
    values, vectors = np.linalg.eig(linear.closed())
    kept = np.abs(values) > 1e-12
    rates = np.log(values[kept].astype(complex)) / linear.period
    modes = named_modes(rates, vectors[:, kept], joints, *energy)
    return min((mode.damping for mode in modes if mode.vibration), default=None)
