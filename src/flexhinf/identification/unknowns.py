"""What is sought in a log: numbers of a plant or robot, and levels of noises; as one vector, with its derivatives.

The vector has the physical numbers first, by their logarithm where they must be positive, then the logarithms of
standard deviations: of the measurement noise of each output, and of each disturbance, N·m·√s of a torque. The
disturbances' part of R^v is G diag(σ²) Gᵀ per second, with G = ∂flow/∂d at the first state; of a map it is that per
period, and σ a standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import refuse_if
from flexhinf.estimation import RecursiveFilter
from flexhinf.plant import Plant
from flexhinf.robot import Robot
from flexhinf.robot.elastic import TEETH
from flexhinf.robot.gears import CURVE
from flexhinf.robot.parameters import QUANTITIES, per_joint
from flexhinf.validation import checked_names, unknown_name

#: Relative step of the differences by which a robot's numbers become those of its plant: products of few of them.
STEP = 1e-5

#: What a number of a robot needs of its plant, see `flexhinf.robot.elastic`.
EXTRA_OF = {
    "damping": "joint_damping",
    "spring_hardening": "spring_hardening",
    "backlash": "backlash",
    **dict.fromkeys(CURVE, "stiffness_curve"),
    **{f"{name}{part}": name for name in TEETH for part in ("", "_phase")},
    "coulomb_friction": "coulomb_friction",
    "static_friction": "stribeck_friction",
    "load_friction": "load_friction",
    "stribeck_velocity": "stribeck_friction",
    "inductance": "inductance",
    "drive_torque_limit": "drive_torque_limit",
}


@dataclass(frozen=True)
class Number:
    """One physical number: `sign` is "positive", "not negative" or "any"."""

    name: str
    value: float
    sign: str = "any"
    unit: str = ""


def quantity_of(robot: Robot, name: str) -> str:
    """The quantity of one of a robot's numbers: its name without the joint's."""
    joints = robot.joint_names
    known = {per_joint(q, joint, len(joints)): q for q in QUANTITIES for joint in joints} | {
        "gravity": "gravity"
    }
    return known[name]


def robot_numbers(robot: Robot, names: Sequence[str]) -> list[Number]:
    """Numbers of a robot by name; a quantity stands for those of all joints. Raises InvalidInput: unknown names."""
    stated = {parameter.name: parameter for parameter in robot.parameters}
    found: dict[str, Number] = {}
    for name in names:
        every = [per_joint(name, joint, len(robot.joint_names)) for joint in robot.joint_names]
        chosen = [name] if name in stated else [label for label in every if label in stated]
        if not chosen:
            raise unknown_name(f"The robot {robot.name!r} states no number {name!r}.", name, sorted(stated))
        for label in chosen:
            quantity = quantity_of(robot, label)
            found[label] = Number(label, stated[label].value, QUANTITIES[quantity].sign, stated[label].unit)
    return list(found.values())


def uncertain_numbers(robot: Robot) -> tuple[str, ...]:
    """Names of a robot's numbers that have a tolerance or a range: what is not known of it."""
    return tuple(each.name for each in robot.parameters if each.interval[0] < each.interval[1])


def plant_numbers(plant: Plant, names: Sequence[str]) -> list[Number]:
    """Numbers of a plant by name; ``name[2]`` is the second of an array, and ``name`` all of them.

    A number that is positive is sought among the positive ones. Raises InvalidInput: unknown names.
    """
    values = plant.parameters.values
    every = {
        label: float(value)
        for name, array in values.items()
        for label, value in (
            [(name, array)]
            if array.ndim == 0
            else [(f"{name}[{k + 1}]", v) for k, v in enumerate(array.ravel())]
        )
    }
    found: dict[str, Number] = {}
    for name in names:
        chosen = [name] if name in every else [label for label in every if label.partition("[")[0] == name]
        if not chosen:
            raise unknown_name(f"The plant has no parameter {name!r}.", name, sorted(every))
        for label in chosen:
            sign = "positive" if every[label] > 0.0 else "any"
            found[label] = Number(label, every[label], sign, plant.unit(label))
    return list(found.values())


def model_of(
    robot: Robot, parameters: str | Sequence[str], measured: str | Sequence[str], extras: str | Sequence[str]
) -> tuple[Plant, list[Number]]:
    """The plant of a robot in which these numbers of it count, and the numbers. Raises InvalidInput: unknown names."""
    numbers = robot_numbers(robot, checked_names("The numbers to identify", parameters))
    return robot.plant(measured, extras=extras_of(robot, numbers, extras)), numbers


def extras_of(robot: Robot, numbers: Sequence[Number], extras: str | Sequence[str]) -> tuple[str, ...]:
    """The extras of the plant in which these numbers of a robot count: those that are stated, and what they need."""
    needed = {EXTRA_OF[q] for n in numbers if (q := quantity_of(robot, n.name)) in EXTRA_OF}
    stated = checked_names("The extras", extras)
    return (*stated, *sorted(needed - set(stated)))


@dataclass(frozen=True, eq=False)
class Noises:
    """R^n = D C D with deviations D and correlations C, and R^v = Σ σᵢ² Bᵢ per second, and what D and σ are at first.

    `correlations`: C (p, p). `deviations`: (p,). `bases`: B (c, n, n). `levels`: σ (c,). `names`: of the levels.
    `sought`: (p + c,), which of D and σ are unknowns. `least`: (p,), smallest D that is looked for.
    """

    correlations: np.ndarray
    deviations: np.ndarray
    bases: np.ndarray
    levels: np.ndarray
    names: tuple[str, ...]
    sought: np.ndarray
    least: np.ndarray

    @staticmethod
    def of(
        filter: RecursiveFilter,
        levels: np.ndarray | None,
        sought: bool | tuple[np.ndarray, bool],
        least: np.ndarray | None = None,
    ) -> Noises:
        """Those of a filter; with `levels` (c,) of its plant's disturbances (or states) instead of its R^v.

        `sought`: whether they are unknowns, all of them or, as a pair, each deviation (p,) and all levels. `least`:
        (p,), the smallest deviations.
        """
        plant, r = filter.plant, filter.measurement_noise
        deviations = np.sqrt(np.diag(r))
        bases, names = (filter.process_noise / filter.period)[None], ("process noise",)
        if levels is not None:
            spread = plant.slopes(filter.initial.mean)[2] if plant.disturbances else np.eye(plant.n)
            lasting = filter.period if plant.sampled else 1.0
            bases = np.array([np.outer(column, column) for column in spread.T]) / lasting
            names = tuple(plant.disturbances or plant.states)
        first = np.ones(1) if levels is None else levels
        each, every = sought if isinstance(sought, tuple) else (np.full(len(r), sought), sought)
        lowest = np.zeros(len(r)) if least is None else np.where(each, least, 0.0)
        return Noises(
            r / deviations / deviations[:, None],
            np.maximum(deviations, lowest),
            bases,
            first,
            names,
            np.append(each, np.full(len(first), every)),
            lowest,
        )

    def matrices(self, deviations: np.ndarray, levels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R^v (n, n) per second, and R^n (p, p)."""
        added = np.einsum("i,ijk->jk", np.square(levels), self.bases)
        return added, self.correlations * deviations * deviations[:, None]


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is sought, and the model's numbers as functions of it.

    `plant`: the model; of a `robot`, its plant. `numbers`: the physical ones. `noises`: beside them. `bounded`: whether
    disturbances are at most those that were assumed at first.
    """

    plant: Plant
    robot: Robot | None
    numbers: Sequence[Number]
    noises: Noises
    bounded: bool = False

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns; of a noise that of its signal, with "noise of " before it."""
        beside = (*self.plant.outputs, *self.noises.names)
        sought = (f"noise of {name}" for name, is_sought in zip(beside, self.noises.sought) if is_sought)
        return (*(number.name for number in self.numbers), *sought)

    @cached_property
    def logarithmic(self) -> np.ndarray:
        """Which unknowns are logarithms, (k,)."""
        physical = [number.sign == "positive" for number in self.numbers]
        return np.array([*physical, *[True] * (len(self.names) - len(physical))])

    @cached_property
    def start(self) -> np.ndarray:
        """The unknowns (k,) at first."""
        physical = [np.log(n.value) if n.sign == "positive" else n.value for n in self.numbers]
        return np.append(physical, np.log(self._stated_noises[self.noises.sought]))

    @property
    def _stated_noises(self) -> np.ndarray:
        return np.append(self.noises.deviations, self.noises.levels)

    def sizes(self, z: np.ndarray) -> np.ndarray:
        """What a change of each unknown (k,) by a hundred per cent is: 1 for a logarithm."""
        nominal = np.array([abs(n.value) for n in self.numbers] + [1.0] * (len(z) - len(self.numbers)))
        return np.where(self.logarithmic, 1.0, np.maximum(np.maximum(np.abs(z), nominal), 1e-6))

    def values(self, z: np.ndarray) -> dict[str, float]:
        """The physical numbers by name."""
        pairs = zip(self.numbers, z.tolist())
        return {n.name: float(np.exp(value)) if n.sign == "positive" else value for n, value in pairs}

    def check_corners(self, z: np.ndarray) -> None:
        """Refuse numbers by which the curve of a gear has its corners in the wrong order."""
        if self.robot is None:
            return
        joints, values = self.robot.joint_names, {**self.robot.nominal, **self.values(z)}
        for joint in joints:
            names = [per_joint(name, joint, len(joints)) for name in ("first_torque", "second_torque")]
            low, high = (values.get(name) for name in names)
            refuse_if(
                low is not None and high is not None and not low < high,
                f"The log does not tell the two corners of the stiffness curve of joint {joint!r}.",
                f"expected {names[0]} < {names[1]}, and the likeliest are {low} and {high}",
                f"{names[0]} alone with the other numbers of the catalogue, or a log whose torques pass both corners",
            )

    def noise_levels(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviations (p,) of the measurements, and levels (c,) of R^v."""
        levels, count = self._stated_noises, len(self.noises.deviations)
        levels[self.noises.sought] = np.exp(z[len(self.numbers) :])
        return levels[:count], levels[count:]

    @cached_property
    def lowest(self) -> np.ndarray:
        """What the unknowns (k,) are at least: zero of a number that must not be negative, the steps of a sensor."""
        numbers = [0.0 if number.sign == "not negative" else -np.inf for number in self.numbers]
        noises = np.append(self.noises.least, np.zeros(len(self.noises.levels)))[self.noises.sought]
        with np.errstate(divide="ignore"):
            return np.append(numbers, np.log(noises))

    @cached_property
    def highest(self) -> np.ndarray:
        """What the unknowns (k,) are at most: the disturbances as they were assumed at first, where those are a
        bound."""
        noises = np.append(np.full(len(self.noises.deviations), np.inf), self.noises.levels)
        numbers = np.full(len(self.numbers), np.inf)
        with np.errstate(divide="ignore"):
            highest = np.append(numbers, np.log(noises[self.noises.sought]))
        return highest if self.bounded else np.full(len(highest), np.inf)

    def inside(self, z: np.ndarray) -> np.ndarray:
        """The unknowns between their lowest and highest."""
        return np.minimum(np.maximum(z, self.lowest), self.highest)

    def free(self, z: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Places of the unknowns that a step may move: not those at a bound that the gradient (k,) points out of."""
        up, down = (z < self.highest) | (gradient <= 0.0), (z > self.lowest) | (gradient >= 0.0)
        return np.flatnonzero(up & down)

    def at(self, z: np.ndarray) -> Plant:
        """The plant with these numbers."""
        return self.plant.with_parameters(**self._changes(z))

    def _changes(self, z: np.ndarray) -> Mapping[str, ArrayLike]:
        """The plant's parameters that these numbers change."""
        values = self.values(z)
        if self.robot is not None:
            return self._of_robot(values)
        table: dict[str, np.ndarray] = {}
        for label, value in values.items():
            name, _, place = label.partition("[")
            array = table.setdefault(name, np.array(self.plant.parameters.values[name], dtype=float))
            array[() if not place else np.unravel_index(int(place[:-1]) - 1, array.shape)] = value
        return table

    def _of_robot(self, values: Mapping[str, float]) -> dict[str, ArrayLike]:
        assert self.robot is not None
        changed = self.robot.plant_parameters({**self.robot.nominal, **values})
        return self.plant.parameters.known(changed)

    def model(self, z: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """(parameters (flat), R^v (n, n) per second, R^n (p, p)), and their derivatives (size, k), one below the
        other."""
        scales = [
            1.0 if n.sign == "positive" else max(abs(at), abs(n.value), 1e-3)
            for n, at in zip(self.numbers, z)
        ]
        moves = STEP * np.diag(np.append(scales, np.zeros(len(z) - len(scales))))[: len(scales)]
        vector, *ends = self.plant.parameters.vectors(
            [self._changes(p) for p in (z, *(z - moves), *(z + moves))]
        )
        deviations, levels = self.noise_levels(z)
        q, r = self.noises.matrices(deviations, levels)
        columns: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for low, high, scale in zip(ends, ends[len(scales) :], scales):
            columns.append(((high - low) / (2.0 * (STEP * scale)), 0.0 * q, 0.0 * r))
        for k in np.flatnonzero(self.noises.sought[: len(deviations)]):
            unit = np.eye(len(deviations))[k]
            columns.append((0.0 * vector, 0.0 * q, r * (unit + unit[:, None])))
        for k in np.flatnonzero(self.noises.sought[len(deviations) :]):
            columns.append((0.0 * vector, 2.0 * levels[k] ** 2 * self.noises.bases[k], 0.0 * r))
        directions = np.array([np.concatenate([part.ravel() for part in column]) for column in columns]).T
        return (vector, q, r), directions
