"""A motion that tells numbers of a robot: moves from stop to stop, the best of many by the information they will give.

The information is that of the likelihood (`flexhinf.identification.likelihood`) along the motion that the robot's model
says: nothing is simulated, and what the motion cannot tell is known before it is driven.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.files import write_file
from flexhinf.identification.defaults import UNKNOWN, disturbance_levels, process_covariance
from flexhinf.identification.information import Information, Unidentifiable
from flexhinf.identification.likelihood import Likelihood
from flexhinf.identification.recursion import rows_of
from flexhinf.identification.unknowns import Noises, Number, Unknowns, model_of
from flexhinf.identification.vibrations import vibration_periods
from flexhinf.loop import Waypoints
from flexhinf.notebook import Summarised
from flexhinf.plant import Plant
from flexhinf.robot import Robot
from flexhinf.robot.command_limits import command_shares
from flexhinf.validation import checked_positive, one_of, real_array

#: Where a joint has no limits: rad or m to each side of the home, and rad/s or m/s.
REACH, SPEED = 0.5, 1.0

#: Largest share of the effort limit and of the speed limit; factor by which a motion is made slower until it keeps
#: them, and how often at most.
SHARE, SLOWER, TIMES = 0.7, 1.2, 60

#: Share of the shortest move's time over which moves are smoothed, the largest speed of such a move in units of its
#: mean, shortest moves in periods of the fastest vibration, and longest in s; and the standard deviation of an encoder
#: where none is stated, rad or m.
SMOOTHING, PEAK, BRIEFEST, LONGEST, ENCODER = 0.2, 2.05, 1.0, 2.0, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Summarised):
    """A motion for `identify`.

    `reference`: positions of the links, a signal for `flexhinf.Loop`. `times` (N,), s; `positions` (N, n), rad or m;
    `inputs` (N, m), those of the model without feedback. `standard_errors`: what the numbers will have, by name, in
    parts of their values; infinite for what this motion does not tell, which `unidentifiable` names.

    Examples
    --------
    >>> import flexhinf as fh
    >>> motion = fh.excitation(fh.paper_arm(), "friction", duration=4.0, period=1e-2, candidates=1)
    >>> motion.positions.shape[1]
    1
    """

    robot: Robot
    reference: Waypoints
    times: np.ndarray
    positions: np.ndarray
    inputs: np.ndarray
    standard_errors: dict[str, float]
    unidentifiable: tuple[Unidentifiable, ...]

    def summary(self) -> dict[str, str]:
        """Duration, stops, and the standard errors to be expected."""
        errors = self.standard_errors.items()
        rows = {"motion": self.reference.name}
        rows |= {k: f"± {100 * e:.2g} %" if np.isfinite(e) else "not told by it" for k, e in errors}
        return rows | {f"not identifiable, {k + 1}": each.text for k, each in enumerate(self.unidentifiable)}

    def table(self, period: float = 0.01) -> str:
        """Positions every `period` s as text, as ``--move`` of the commands reads it."""
        times = np.append(np.arange(0.0, self.reference.duration, period), self.reference.duration)
        rows = np.column_stack([times, np.reshape(self.reference(times), (len(times), -1))])
        units = self.robot.links.position_units
        head = ", ".join(["time [s]", *(f"{n} [{u}]" for n, u in zip(self.robot.joint_names, units))])
        return "\n".join([head, *(", ".join(f"{x:.9g}" for x in row) for row in rows)]) + "\n"

    def save(self, path: str | os.PathLike[str], period: float = 0.01) -> None:
        """Write `table` to a file."""
        text = self.table(period)
        write_file(path, "motion", lambda name: Path(name).write_text(text, encoding="utf-8"))


def excitation(
    robot: Robot,
    parameters: str | Sequence[str],
    *,
    duration: float = 10.0,
    period: float = 1e-3,
    measured: str | Sequence[str] = ("link_position",),
    extras: str | Sequence[str] = (),
    noise: Mapping[str, float] | None = None,
    reach: ArrayLike | None = None,
    candidates: int = 12,
    seed: int = 0,
) -> Excitation:
    """A motion, jerk-limited and within the joints' limits, that tells these numbers of a robot best.

    Parameters
    ----------
    robot, parameters, measured, extras
        As for `identify`.
    duration, period : float
        Of the motion at most, and of the samples, s.
    noise : mapping of str to float, optional
        Standard deviations of the measured signals, and levels of disturbances, by name, as `Identification.noise`.
    reach : float, (n,) or (n, 2) array, optional
        How far from the home each joint may move to each side, or from where to where; by default within its limits,
        and `REACH` of the home where it has none.
    candidates, seed : int
        Random motions that are tried. That with the smallest largest standard error is taken.

    Raises InvalidInput: for unknown names, or a motion that cannot be made within the limits.

    Examples
    --------
    >>> import flexhinf as fh
    >>> motion = fh.excitation(fh.paper_arm(), "stiffness", duration=4.0, period=1e-2, candidates=2)
    >>> motion.standard_errors["stiffness"] > 0.0
    True
    """
    plant, numbers = model_of(robot, parameters, measured, extras)
    span, step = (
        checked_positive("The duration", duration, "seconds", "10"),
        checked_positive("The period", period, "seconds", "1e-3"),
    )
    box, rng = _box(robot, reach), np.random.default_rng(seed)
    for name in noise or {}:
        one_of(
            f"There is no noise of {name!r}.", name, (*plant.outputs, *(plant.disturbances or plant.states))
        )
    vibration, speeds = float(vibration_periods(robot)[0]), _speeds(robot)
    best: tuple[tuple[int, float], Excitation] | None = None
    for _ in range(max(1, int(candidates))):
        moved = _within_limits(robot, _stops(rng, box, speeds, span, vibration), speeds, span, step)
        if moved is None:
            continue
        found = _judged(robot, plant, numbers, dict(noise or {}), step, *moved)
        errors = list(found.standard_errors.values())
        score = sum(np.isinf(errors)), max([e for e in errors if np.isfinite(e)], default=0.0)
        if best is None or score < best[0]:
            best = score, found
    if best is None:
        raise InvalidInput(
            "No motion keeps the robot's limits.",
            f"expected one of {candidates} within {SHARE:g} of effort and speed in {span:g} s, got none",
            "a longer duration, or a smaller reach",
        )
    return best[1]


def _box(robot: Robot, reach: ArrayLike | None) -> np.ndarray:
    """Ends (n, 2) of the links' positions."""
    home = np.asarray(robot.home, dtype=float)
    if reach is None:
        ends = [
            (h - REACH, h + REACH) if limits is None or not np.all(np.isfinite(limits)) else limits
            for h, limits in zip(home, robot.links.limits)
        ]
        low, high = np.array(ends, dtype=float).T
        margin = 0.05 * (high - low)
        return np.stack([low + margin, high - margin], axis=1)
    stated, size = real_array(reach), len(home)
    refuse_if(
        stated.shape not in ((), (size,), (size, 2)),
        "The reach does not fit the joints.",
        f"expected one number, {size}, or {size} pairs for {list(robot.joint_names)}, got shape {stated.shape}",
        "reach=0.3, or a pair for each joint",
    )
    apart = np.multiply.outer(np.broadcast_to(stated, size), [-1.0, 1.0]) if stated.ndim < 2 else stated
    box = home[:, None] + apart if stated.ndim < 2 else stated
    limits = np.array(
        [(-np.inf, np.inf) if ends is None else ends for ends in robot.links.limits], dtype=float
    )
    fits = np.isfinite(box).all() and (box[:, 0] < box[:, 1]).all()
    refuse_if(
        not fits or bool((box[:, 0] < limits[:, 0]).any() or (box[:, 1] > limits[:, 1]).any()),
        "The reach does not fit the joints.",
        f"expected low < high within {limits.tolist()}, got {box.tolist()}",
        "reach=0.3, or a pair for each joint",
    )
    return box


def _speeds(robot: Robot) -> np.ndarray:
    """Largest speeds (n,) of a motion."""
    limits = [np.inf if limit is None else limit for limit in robot.speed_limits or ()]
    return np.array([SHARE * limit if np.isfinite(limit) else SPEED for limit in limits])


def _stops(
    rng: np.random.Generator, box: np.ndarray, speeds: np.ndarray, span: float, vibration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times (K,) and poses (K, n) of random stops: fast and slow moves, long and short ones."""
    shortest = min(max(BRIEFEST * vibration, 0.05), 0.25 * span)
    times, poses = [0.0], [np.asarray(box.mean(axis=1))]
    while times[-1] < span:
        size = rng.choice([0.2, 0.6, 1.0])
        goal = poses[-1] + size * (rng.uniform(box[:, 0], box[:, 1]) - poses[-1])
        low, high = float(np.log(shortest)), float(np.log(max(LONGEST, 2.0 * shortest)))
        lasting = float(np.exp(rng.uniform(low, high)))
        times.append(times[-1] + max(lasting, PEAK * float((np.abs(goal - poses[-1]) / speeds).max())))
        poses.append(goal)
    return np.array(times), np.array(poses)


def _within_limits(
    robot: Robot, stops: tuple[np.ndarray, np.ndarray], speeds: np.ndarray, span: float, period: float
) -> tuple[Waypoints, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """The motion, slower until it keeps speed, effort and changes of commands, its times, positions, states and inputs;
    or None."""
    times, poses = stops
    efforts = np.array([np.inf if limit is None else SHARE * limit for limit in robot.effort_limits or ()])
    for _ in range(TIMES):
        kept = times <= span * (1.0 + 1e-9)
        if kept.sum() < 2:
            return None
        gap = float(np.diff(times[kept]).min())
        motion = Waypoints(times[kept], poses[kept], "jerk-limited", smoothing=SMOOTHING * gap)
        t = np.arange(0.0, motion.duration + period, period)
        orders = motion.derivatives(t, 4).reshape(5, len(t), -1)
        q, dq, ddq, dddq, ddddq = orders
        states, u = robot.inverse_dynamics(q, dq, ddq, dddq, ddddq)
        slow = np.max(command_shares(robot, u, period)) <= SHARE
        if slow and (np.abs(dq) <= speeds).all() and (np.abs(u) <= efforts).all():
            return motion, t, q, states, u
        times = SLOWER * times
    return None


def _judged(
    robot: Robot,
    plant: Plant,
    numbers: Sequence[Number],
    noise: dict[str, float],
    period: float,
    motion: Waypoints,
    times: np.ndarray,
    positions: np.ndarray,
    states: np.ndarray,
    inputs: np.ndarray,
) -> Excitation:
    """What a motion tells."""
    vector, states = plant.parameters.vector(), _whole_states(robot, plant, states, inputs)
    outputs = np.array([plant.evaluate_output(x, u, vector) for x, u in zip(states, inputs)])
    sizes = [noise.get(name, ENCODER) for name in plant.outputs]
    usual = disturbance_levels(plant, states[0], inputs, period)
    levels = np.array(
        [
            max(noise.get(name, float(level)), 1e-12)
            for name, level in zip(plant.disturbances or plant.states, usual)
        ]
    )
    added = process_covariance(plant, states[0], levels, period)
    filter = ExtendedKalmanFilter(
        plant, period, added, np.square(sizes), states[0], UNKNOWN**2, form="covariance"
    )
    unknowns = Unknowns(plant, robot, numbers, Noises.of(filter, levels, True))
    likelihood = Likelihood(filter, rows_of(times, inputs, outputs, period), len(unknowns.names))
    evaluation = likelihood.evaluate(*unknowns.model(unknowns.start))
    if evaluation is None:
        return Excitation(robot, motion, times, positions, inputs, {n.name: np.inf for n in numbers}, ())
    size = unknowns.sizes(unknowns.start)
    found = Information.expected(evaluation, unknowns.names, size, len(numbers))
    errors = dict(zip((number.name for number in numbers), found.standard_errors.tolist()))
    return Excitation(robot, motion, times, positions, inputs, errors, found.unidentifiable)


def _whole_states(robot: Robot, plant: Plant, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """States (N, n) of a plant that has more of them than a motion gives, such as motor currents: these follow at once,
    so that they stand where they would come to rest."""
    known = [plant.states.index(name) for name in robot.plant().states]
    fast = [k for k in range(plant.n) if k not in known]
    whole = np.zeros((len(states), plant.n))
    whole[:, known] = states
    if fast:
        slope = plant.slopes(whole[0], inputs[0])[0][np.ix_(fast, fast)]
        whole[:, fast] = -np.linalg.solve(slope, plant.derivative(whole, inputs)[:, fast].T).T
    return whole
