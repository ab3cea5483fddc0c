"""A robot: parameters with tolerances, and the plants and problems made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import GeneralisedPlant, Penalty, Plant
from flexhinf.robot.parameter import Parameter
from flexhinf.robot.single_link import REQUIRED, single_link_plant

__all__ = ["Robot"]


@dataclass(frozen=True)
class Robot:
    """A robot with elastic joints.

    Parameters
    ----------
    name : str
    parameters : sequence of Parameter
        Physical numbers with tolerances and sources.
    penalty : Penalty
        The robot's own penalty, used by `problem`.
    """

    name: str
    parameters: tuple[Parameter, ...]
    penalty: Penalty

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        names = [parameter.name for parameter in self.parameters]
        missing = [name for name in REQUIRED if name not in names]
        if missing or len(set(names)) != len(names):
            raise InvalidInput(
                f"The robot {self.name!r} does not have the parameters of its model.",
                f"expected each of {list(REQUIRED)} once, got {names}",
                f"add {missing}" if missing else "each name once",
            )

    @cached_property
    def nominal(self) -> dict[str, float]:
        """Nominal values by name."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    def __getitem__(self, name: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise InvalidInput(
            f"The robot {self.name!r} has no parameter {name!r}.",
            f"expected one of {list(self.nominal)}",
            "one of these",
        )

    def with_values(self, values: Mapping[str, float]) -> Robot:
        """The same robot with other nominal values; unknown names raise InvalidInput."""
        for name in values:
            self[name]
        changed = tuple(replace(p, value=float(values.get(p.name, p.value))) for p in self.parameters)
        return replace(self, parameters=changed)

    def plant(self, measured: Sequence[str] = ("link_position",), inductance: bool = False) -> Plant:
        """Physics with voltage-driven motors.

        Parameters
        ----------
        measured : sequence of str
            Measured signals, out of link_position, motor_position, joint_torque, link_velocity and
            motor_velocity.
        inductance : bool
            With the motor coil's inductance, which adds the state coil_current (A).
        """
        measured = (measured,) if isinstance(measured, str) else tuple(measured)
        return single_link_plant(self.nominal, measured, inductance)

    def problem(
        self, penalty: Any = None, pose: Any = None, measured: Sequence[str] = ("link_position",)
    ) -> GeneralisedPlant:
        """The paper's problem: penalty (11), five states, the command as the disturbance, about rest.

        Parameters
        ----------
        penalty : Penalty or weights, optional
            Instead of the robot's own; weights alone come with R2 = 1, see `Penalty`.
        pose : sequence or mapping, optional
            Link position to design about, rad; hanging by default.
        measured : sequence of str
            As for `plant`.
        """
        return self.plant(measured).with_objective(
            self.penalty if penalty is None else penalty,
            command="disturbance",
            integrate=("link_position",),
            pose=pose,
        )

    # Tolerances -----------------------------------------------------------------------------------
    @property
    def uncertain(self) -> tuple[Parameter, ...]:
        """The parameters with a tolerance."""
        return tuple(p for p in self.parameters if p.tolerance > 0.0)

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """All parameters, the uncertain ones uniform in their intervals."""
        return {p.name: float(rng.uniform(*p.interval)) if p.tolerance else p.value for p in self.parameters}

    def corner(self, signs: Mapping[str, float] | Sequence[float]) -> dict[str, float]:
        """All parameters, the uncertain ones at one end of their intervals.

        Parameters
        ----------
        signs : mapping by name (0 if absent) or one number per uncertain parameter
            −1, 0 or 1: lower end, nominal, upper end; anything between is allowed.

        Raises
        ------
        InvalidInput
            For unknown names, another number of signs, or a sign outside [−1, 1].
        """
        if not isinstance(signs, Mapping):
            if len(signs) != len(self.uncertain):
                raise InvalidInput(
                    "A corner needs one sign per uncertain parameter.",
                    f"expected one for each of {[p.name for p in self.uncertain]}, got {len(signs)}",
                    "a sign, −1, 0 or 1, for each",
                )
            signs = {p.name: s for p, s in zip(self.uncertain, signs, strict=True)}
        for name, sign in signs.items():
            self[name]
            if not -1.0 <= sign <= 1.0:
                raise InvalidInput(
                    f"The sign for {name!r} leaves its tolerance.",
                    f"expected −1 to 1, got {sign!r}",
                    "−1, 0 or 1",
                )
        return {p.name: p.at(float(signs.get(p.name, 0.0))) for p in self.parameters}
