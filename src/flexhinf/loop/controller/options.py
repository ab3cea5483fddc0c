"""What a controller is given beside its law: mode, limits and period, checked before any work is lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import INTEGRAL, Estimator, Law
from flexhinf.validation import checked_positive, real_array, value_text


class Source(NamedTuple):
    """Where a tracked state is read, and its place among the states of the plant: of the measurement where it is
    measured, else of the estimate. So the integral removes the error of the measured signal, whatever the estimator's
    model gets wrong."""

    measured: bool
    place: int
    state: int

    @staticmethod
    def of(name: str, states: Sequence[str], measured: Sequence[str]) -> Source:
        """Of a state by name."""
        state = states.index(name)
        return Source(True, measured.index(name), state) if name in measured else Source(False, state, state)


@dataclass(frozen=True)
class Mode:
    """Options that change the code of a step, beside law and estimator.

    `moving`: the law acts about a moving reference (x_d, u_d) instead of the operating point. `start`: the integrals
    at the first sample are "zero", or such that the input continues from the one before, "bumpless". Of `laws` one is
    active at a time. The flags say what has limits (the input itself always may), whether small errors are not
    integrated, and whether what integrals push is bounded, as some input has no limit.
    """

    moving: bool = False
    start: str = "zero"
    laws: int = 1
    limits_command: bool = False
    limits_input_rate: bool = False
    has_dead_zone: bool = False
    bounds_windup: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.moving, bool):
            raise InvalidInput(
                "Whether the law acts about a moving reference is not said.",
                f"expected moving=True or moving=False, got {value_text(self.moving)}",
                "moving=True for commands (x_d, u_d) of states and inputs",
            )
        if self.start not in ("zero", "bumpless"):
            raise InvalidInput(
                "There is no such start of a controller.",
                f"expected 'zero' or 'bumpless', got {value_text(self.start)}",
                "start='bumpless' to continue from the last input",
            )

    @property
    def bumpless(self) -> bool:
        """Whether the law takes over the last input at the first sample."""
        return self.start == "bumpless"

    @property
    def takes_over(self) -> bool:
        """Whether a law ever takes over: at the first sample, or from another law."""
        return self.bumpless or self.laws > 1


#: Shortest and longest sampling period of a controller, s.
PERIODS = (1e-6, 1.0)


def checked_period(value: Any) -> float:
    """A sampling period, s, within `PERIODS`; else an InvalidInput asks for the unit that was probably meant."""
    period = checked_positive("The sampling period", value, "seconds", "1e-3 for 1 kHz")
    low, high = PERIODS
    if low <= period <= high:
        return period
    meant = "a period in seconds: 1e-3 for 1 kHz"
    if period > high:
        meant = f"period={1e-3 * period:g} if {period:g} ms was meant"
        if period >= 10.0:
            meant += f", or {1.0 / period:g} for a rate of {period:g} Hz"
    raise InvalidInput(
        "The sampling period is out of proportion.",
        f"expected {low:g} s to {high:g} s, got {period:g} s",
        meant,
    )


@dataclass(frozen=True, eq=False)
class Limits:
    """Lower and upper limits of some signals, and of their rates, (m,) each, infinite where there is none."""

    lower: np.ndarray
    upper: np.ndarray
    rate: np.ndarray

    @property
    def pair(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits."""
        return self.lower, self.upper

    @property
    def texts(self) -> list[str]:
        """Each range, for a summary."""
        return [f"{low:.4g} to {high:.4g}" for low, high in zip(self.lower.tolist(), self.upper.tolist())]

    @property
    def rated(self) -> bool:
        """Whether any rate is limited."""
        return bool(np.isfinite(self.rate).any())

    @property
    def active(self) -> bool:
        """Whether there is any limit."""
        return self.rated or bool(np.isfinite(self.pair).any())

    @staticmethod
    def of(
        saturation: Any, inputs: int, rate: Any = None, names: tuple[str, str] = ("saturation", "input_rate")
    ) -> Limits:
        """Of m signals: the range from None, a number (±), an array with one number (±) each, or a tuple (lower, upper)
        of them; the largest rate per second from None, a number or (m,). The names are those of both arguments.

        What has another shape, does not keep lower < upper, or is no positive rate is an InvalidInput.
        """
        name, rate_name = names

        def ends(value: Any, name: str, advice: str) -> np.ndarray:
            try:
                return np.array(np.broadcast_to(real_array(value), (inputs,)))
            except (TypeError, ValueError) as error:
                what = "command" if name.startswith("command") else "inputs"
                raise InvalidInput(
                    f"The {LIMITS[name]} does not fit the {what}.",
                    f"expected one number or {inputs}, got {value_text(value)}",
                    f"{name}={advice}",
                ) from error

        rates = np.full(inputs, np.inf) if rate is None else ends(rate, rate_name, "2.0 per second")
        if not np.all(rates > 0.0):
            raise InvalidInput(
                f"The {LIMITS[rate_name]} is not positive.",
                f"expected numbers > 0 per second, got {value_text(rate)}",
                f"{rate_name}=2.0, or one per signal",
            )
        if saturation is None:
            return Limits(np.full(inputs, -np.inf), np.full(inputs, np.inf), rates)
        advice = f"48.0 for ±48, or {name}=(lower, upper)"
        pair = isinstance(saturation, tuple) and len(saturation) == 2
        lower, upper = (
            ends(part, name, advice) for part in (saturation if pair else (saturation, saturation))
        )
        lower = lower if pair else -upper
        if not np.all(lower < upper):
            raise InvalidInput(
                f"The {LIMITS[name]} leaves no room for the {'input' if name == 'saturation' else 'command'}.",
                f"expected lower < upper, got lower={lower.tolist()}, upper={upper.tolist()}",
                f"{name}={advice}",
            )
        return Limits(lower, upper, rates)


#: What the limits of a controller are called, by the names of its arguments.
LIMITS = {
    "saturation": "saturation", "input_rate": "rate of the input", "command_range": "range of the command",
    "command_rate": "rate of the command",
}  # fmt: skip


def command_limits(command_range: Any, command_rate: Any, tracked: Sequence[str], moving: bool) -> Limits:
    """Limits of a standing command, from the arguments of a controller; refused beside a moving reference, whose
    velocity and input would no longer fit its position, and where nothing is commanded."""
    if (command_range is None and command_rate is None) or (tracked and not moving):
        return Limits.of(command_range, len(tracked), command_rate, ("command_range", "command_rate"))
    raise InvalidInput(
        "A limit of the command is given where positions are not commanded alone.",
        f"expected a law with integrals and moving=False, got moving={moving} and {len(tracked)} integrals",
        "check_reference(robot, reference, duration) before the move; a plan (JerkLimited) has a largest velocity",
    )


def dead_zone(value: Any, tracked: Sequence[str]) -> np.ndarray | None:
    """Largest errors (k,) that are not integrated, of a number or one per tracked state; None without any. What does
    not fit or is negative is refused, and any where nothing is integrated."""
    if value is None:
        return None
    zone = real_array(value)
    if not tracked or zone.shape not in ((), (len(tracked),)) or not np.all(zone >= 0.0):
        raise InvalidInput(
            "The dead zone of the integrals does not fit.",
            f"expected one number >= 0 or one for each of the integrated {list(tracked)}, got {value_text(value)}",
            "integral_dead_zone=1e-3" if tracked else "integral_dead_zone=None, as this law tracks nothing",
        )
    return np.array(np.broadcast_to(zone, (len(tracked),))) if zone.any() else None


def check_kinds(law: Any, estimator: Any) -> None:
    """They are a law with finite numbers of the right sizes, and an estimator or None."""
    if not isinstance(law, Law):
        raise InvalidInput(
            "The controller needs a law.", f"expected a flexhinf.plant.Law, got {type(law).__name__}",
            "a solution of solve_hji or linear_law, or a subclass of flexhinf.plant.Law",
        )  # fmt: skip
    if estimator is not None and not isinstance(estimator, Estimator):
        raise InvalidInput(
            "The controller's estimator is none.",
            f"expected a flexhinf.plant.Estimator or None, got {type(estimator).__name__}",
            "Controller(solution, UnscentedKalmanFilter(...), period)",
        )
    n, m = len(law.state_names), len(law.input_names)
    point, rest = np.asarray(law.operating_point), np.asarray(law.operating_input)
    if point.shape != (n,) or rest.shape != (m,) or not np.all(np.isfinite(np.ravel(law.law_data))):
        raise InvalidInput(
            "The law's numbers do not fit its names, or are not finite.",
            f"expected an operating point ({n},) and input ({m},), got {point.shape} and {rest.shape}",
            "one value per name",
        )


def check_names(law: Law, estimator: Estimator | None, period: float) -> None:
    """The law's states are the plant's, then integrals; the estimator means the same, at the same period."""
    states, tracked = law.plant_states, law.tracked
    order = (*states, *(name + INTEGRAL for name in tracked))
    if order != tuple(law.state_names) or not set(tracked) <= set(states):
        raise InvalidInput(
            "The law's states are not the plant's states followed by integrals of some of them.",
            f"got {list(law.state_names)}", "name the integral of the error of NAME 'NAME_integral', last",
        )  # fmt: skip
    if estimator is None:
        return
    plant, inputs = estimator.plant, tuple(law.input_names)
    if (tuple(plant.states), tuple(plant.inputs)) != (states, inputs):
        raise InvalidInput(
            "The estimator and the law do not mean the same states and inputs.",
            f"the law needs {list(states)} and {list(inputs)}, "
            f"the estimator's plant has {list(plant.states)} and {list(plant.inputs)}",
            "the same plant for both",
        )
    if abs(estimator.period - period) > 1e-12 * period:
        raise InvalidInput(
            "The estimator and the controller run at different periods.",
            f"expected {period} s, got {estimator.period} s",
            "the same period for both",
        )
