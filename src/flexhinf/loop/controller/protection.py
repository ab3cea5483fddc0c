"""Limits beyond which a robot within its tolerances does not move, and what stops it there.

The signs of it are those of `flexhinf.loop.controller.signs`; `flexhinf.export.protected` computes the limits of a
robot's file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop.controller.options import Listed
from flexhinf.loop.controller.signs import SIGNS, Pair, Watch
from flexhinf.loop.controller.status import Supervision
from flexhinf.plant import Estimator
from flexhinf.stops import STOPS
from flexhinf.validation import one_of, real_array, value_text

#: Time constant of the observer of a motor, s, and the largest part of it in a sample.
OBSERVED, QUICKEST = 1.0 / 80.0, 0.25

#: Time for which readings must rest before a start, s.
LOOK = 0.05

#: How many times the longest way of its own a joint may go after a pause of the loop, beside that.
FREE = 2.0

#: Samples for which a sensor may be missing.
LONGEST_UNSEEN = 10

#: Time over which the speed of a reading is averaged at least, s.
WINDOW = 0.01

#: Bits of the reasons that are signs, in their order.
SIGN_BITS = tuple(1 << list(STOPS).index(name) for name in ("bad_start", *SIGNS))

#: What inputs may be for a controlled stop.
DRIVES = ("torque", "velocity", "position")


class Pausing(NamedTuple):
    """What a long pause of the loop changes: for how many samples motors are not observed, the ways that joints have
    free (k,), and how many periods are a long pause."""

    settles: float = 0.0
    free: Any = 0.0
    longest: float = math.inf


#: Numbers of a protection that are above 0.
POSITIVE = (
    "speed", "window", "step", "distance", "travel", "swing", "smoothing", "hardest", "breakaway", "misplaced",
)  # fmt: skip


@dataclass(frozen=True)
class Protection(Listed):
    """Limits beyond which a robot within its tolerances does not move, and what a protective stop does.

    Of measured signals (p,), inputs (m,), commanded positions (k,), joints with two readings of their spring (g,),
    links (n,), and tolerances that do not depend on each other (G,).

    Parameters
    ----------
    speed : (p,)
        Largest speed of a reading, in its unit per s; infinite for none.
    window : (p,)
        Time over which it is averaged, s.
    step : (p,)
        Step of the values, or what the noise makes of it; infinite for a signal that tells no repeated frame.
    distance, travel : (k,)
        How far from its command a joint's own way away from it begins to count, and how long it may be, rad or m.
    motors, twists, inputs : (g,) str
        Signals of the motors' positions, of the twists or torques of their springs ("" where links tell these), and
        names of the inputs.
    links : (n,) str
        Signals of the links' positions.
    shares : (n, g)
        By how much the motors turn with the links where their springs are relaxed.
    compliance : (g,)
        Twist per unit of a twist's signal: 1, or that of the spring where the signal is its torque.
    rates : (5, g)
        Accelerations of the motors per input, position, twist, speed, and speed of the twist.
    spreads : (G, 5, g)
        By how much these are others at the end of each tolerance.
    floor : (g,)
        What is left out of them, rad/s² or m/s²: dry friction, offsets of encoders, noise.
    most : (g,)
        Accelerations of motors at which their drives' own loops saturate; infinite without such a loop.
    unsure : (g,)
        Share of what the loop wants beyond that which may be there: 0 where the limit is known, else 1.
    alone : sequence of str
        Encoders of motors that no other sensor contradicts.
    hardest : sequence of float
        Largest accelerations of these motors, rad/s² or m/s².
    breakaway : sequence of float
        Changes of their inputs that move them, whatever dry friction there is; infinite where that is not known.
    moved : (m,) str
        Signals that tell the speed of what the inputs move, "" where none does.
    swing : (2, m)
        Smallest swing of an input that counts where it grows, and the one that counts always.
    damping : (m,)
        Input per speed of what it moves, by which a controlled stop slows it down.
    response : (m,)
        Acceleration of a motor per input, without its spring, in units of the joint.
    winding : (2, m)
        Accelerations of a motor and of its link per twist of their spring, 1/s².
    smoothing : (m,)
        Time constant of the speeds that a controlled stop slows down, s.
    brakes : (m,) bool
        Whether what an input moves has a brake that closes without power. Where all have, a stop is of category 0 of
        IEC 60204-1 [iec60204], else of category 1.
    misplaced : (p,)
        How far a reading may be from where the controller begins; infinite for a signal that tells no place.
    moved_at_start : (p,)
        How far it may move in the `LOOK` before a start; infinite likewise.
    twist_at_start : (g,)
        How far the twists of springs at rest may be from those of the model.
    longest_unseen : int
        Samples for which a sensor may be missing or refused.
    drive : {"torque", "velocity", "position"}
        What the inputs are, for a controlled stop; currents and voltages count as torques.
    stop_on : sequence of str
        What stops the robot, of `flexhinf.stops.STOPS`; all by default.

    Raises
    ------
    InvalidInput
        If sizes differ, numbers are not positive, or something is no reason for a stop.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import flexhinf as fh
    >>> def stopped_by(controller, *reasons):  # the same controller, which other reasons do not stop
    ...     return controller.fresh(protection=replace(controller.protection, stop_on=reasons))
    >>> def free(folder):
    ...     return stopped_by(fh.load_controller(folder), "sensor_lost", "too_fast")
    """

    speed: Sequence[float]
    window: Sequence[float]
    step: Sequence[float]
    distance: Sequence[float]
    travel: Sequence[float]
    swing: Sequence[Sequence[float]]
    damping: Sequence[float]
    response: Sequence[float]
    winding: Sequence[Sequence[float]]
    smoothing: Sequence[float]
    brakes: Sequence[bool]
    motors: Sequence[str] = ()
    twists: Sequence[str] = ()
    inputs: Sequence[str] = ()
    links: Sequence[str] = ()
    shares: Sequence[Sequence[float]] = ()
    compliance: Sequence[float] = ()
    rates: Sequence[Sequence[float]] = ()
    spreads: Sequence[Sequence[Sequence[float]]] = ()
    floor: Sequence[float] = ()
    most: Sequence[float] = ()
    unsure: Sequence[float] = ()
    alone: Sequence[str] = ()
    hardest: Sequence[float] = ()
    breakaway: Sequence[float] = ()
    moved: Sequence[str] = ()
    misplaced: Sequence[float] = ()
    moved_at_start: Sequence[float] = ()
    twist_at_start: Sequence[float] = ()
    drive: str = "torque"
    longest_unseen: int = LONGEST_UNSEEN
    stop_on: Sequence[str] = tuple(STOPS)

    def __post_init__(self) -> None:
        sizes = len(self.motors), len(self.speed), len(self.distance), len(self.damping), len(self.alone)
        g, p, k, m, a = sizes
        shapes = {
            "speed": (p,), "window": (p,), "step": (p,), "distance": (k,), "travel": (k,), "swing": (2, m),
            "damping": (m,), "response": (m,), "winding": (2, m), "smoothing": (m,), "brakes": (m,), "moved": (m,),
            "twists": (g,), "inputs": (g,), "shares": (len(self.links), g), "compliance": (g,), "rates": (5, g),
            "floor": (g,), "most": (g,), "unsure": (g,), "hardest": (a,), "breakaway": (a,),
            "misplaced": (p,), "moved_at_start": (p,), "twist_at_start": (g,),
        }  # fmt: skip
        arrays = {name: np.array(getattr(self, name)) for name in shapes}
        arrays |= {"spreads": _table(self.spreads, 5, g)}
        if not g:
            arrays |= {"rates": np.zeros((5, 0))}
        if not g or not self.links:
            arrays |= {"shares": np.zeros((len(self.links), g))}
        apart = [name for name, shape in shapes.items() if arrays[name].shape != shape]
        apart += [name for name in POSITIVE if not apart and not np.all(arrays[name] > 0.0)]
        refuse_if(
            bool(apart),
            "The protection of a controller does not fit itself.",
            f"expected positive numbers for {p} signals, {k} positions, {m} inputs, {g} joints and {a} encoders, got "
            f"{ {name: value_text(getattr(self, name)) for name in apart} }",
            "fh.export.protected(controller, robot), which computes them of a robot's file",
        )
        one_of("There is no such drive of a protection.", self.drive, DRIVES)
        for reason in self.stop_on:
            one_of("There is no such reason for a stop.", reason, STOPS)
        kept = {name: array.tolist() for name, array in arrays.items()}
        vars(self).update({name: tuple(value) for name, value in kept.items()}, stop_on=tuple(self.stop_on))

    def watch(
        self,
        inputs: Sequence[str],
        estimator: Estimator | None,
        limits: tuple[np.ndarray, ...] | None,
        supervision: Supervision | None,
    ) -> Watch:
        """Places of what is watched, of a controller's parts; a name that is none of its signals is refused, and any
        without an estimator, limits of measurements, or a supervision that reports the signs."""
        if estimator is None or limits is None or supervision is None:
            raise InvalidInput(
                "Nothing reads the signs of a protection.",
                f"expected an estimator, measurement_limits and a supervision, got {type(estimator).__name__}, "
                f"{value_text(limits)} and {value_text(supervision)}",
                "measurement_limits=(-inf, inf, inf) and supervision=Supervision(); or protection=None",
            )
        measured = tuple(estimator.plant.outputs)
        for name in (*self.motors, *self.links, *filter(None, self.twists), *self.alone):
            one_of("The protection of a controller names what it does not measure.", name, measured)
        for name in self.alone:
            one_of(
                "The protection of a controller names an encoder of what no input moves.", name, self.moved
            )
        for name in self.inputs:
            one_of("The protection of a controller names an input that it has not.", name, inputs)
        refuse_if(
            (len(self.speed), len(self.damping)) != (len(measured), len(inputs)),
            "The protection of a controller does not fit its signals.",
            f"expected numbers for {len(measured)} measured signals and {len(inputs)} inputs, got {len(self.speed)} "
            f"and {len(self.damping)}",
            "fh.export.protected(controller, robot)",
        )
        places, pairs = {name: k for k, name in enumerate(measured)}, list[Pair]()
        for j, (motor, twist, input) in enumerate(zip(self.motors, self.twists, self.inputs)):
            links = [
                (places[link], i) for i, link in enumerate(self.links) if not twist and self.shares[i][j]
            ]
            terms = tuple(tuple(i for i, rate in enumerate(row) if rate[j]) for row in self.spreads)
            own = places[twist] if twist else None
            place = list(inputs).index(input)
            pairs.append(Pair(places[motor], tuple(links), own, place, self.drive != "torque", terms))
        moved = tuple(places[name] if name else None for name in self.moved)
        alone = tuple((places[name], moved.index(places[name])) for name in self.alone)
        return Watch(tuple(pairs), moved, alone)

    @property
    def category(self) -> int:
        """Category of a protective stop: 0 where every joint has a brake, else 1."""
        return 0 if all(self.brakes) else 1

    def pausing(self, period: float) -> Pausing:
        """What a long pause of the loop changes."""
        free = FREE * np.array(self.travel, dtype=float)
        return Pausing(float(np.ceil(LOOK / period)), free, self.longest_unseen)

    def data(self, period: float) -> dict[str, np.ndarray]:
        """Numbers of the step."""
        rates = np.array(self.rates, dtype=float).reshape(5, -1)
        shares = np.array(self.shares, dtype=float).reshape(len(self.links), rates.shape[1])
        observers = [observer_of(period, -rate) for rate in rates[3].tolist()]
        observer = np.reshape(observers, (-1, 6)).T
        return {
            "fastest": np.array(self.speed),
            "distances": np.array([self.distance, self.travel]),
            "swing_sizes": np.array(self.swing),
            "motor_rates": rates,
            "motor_spreads": _table(self.spreads, 5, rates.shape[1]),
            "motor_numbers": np.vstack(
                [observer, [self.floor], [self.compliance], [self.most], [self.unsure], shares]
            ),
            "hardest": np.array(self.hardest),
            "breakaway": np.array(self.breakaway),
            "misplaced": np.array(self.misplaced),
            "longest_unseen": np.array([self.longest_unseen], dtype=float),
            "stop_on": np.array(
                [bit * (name in self.stop_on) for name, bit in zip(("bad_start", *SIGNS), SIGN_BITS)],
                dtype=float,
            ),
            **windows_and_steps(period, self.window, self.step),
        }


def _table(rows: Sequence[Sequence[Sequence[float]]], count: int, columns: int) -> np.ndarray:
    """Rows (G, count, columns) of numbers, none where there are no columns."""
    return np.array(rows, dtype=float).reshape(-1 if columns else 0, count, columns)


def windows_and_steps(period: float, window: ArrayLike, step: ArrayLike) -> dict[str, np.ndarray]:
    """Numbers of the step by which readings are looked at, of windows, s, and steps of their values (p,)."""
    return {
        "reading_windows": np.minimum(period / real_array(window), 1.0),
        "reading_steps": real_array(step),
    }


def observer_of(period: float, damping: float) -> tuple[float, ...]:
    """The first six numbers of an `Observer` of a motor that slows down by `damping`, 1/s: both eigenvalues of the
    error are those of `OBSERVED`, or of one that is fast enough to correct the position by as large a share as that
    forgets in a sample."""
    damping = max(damping, 1e-6 / period)
    left = float(np.exp(-damping * period))
    way = (1.0 - left) / damping
    pushed = (period - way) / damping
    own = min(period / OBSERVED, QUICKEST)
    pole = min(float(np.exp(-own)), float(np.sqrt(left * (1.0 - own))))
    first = 1.0 - pole * pole / left
    second = (1.0 - first + left - 2.0 * pole) / way
    kept = np.array([[1.0 - first, 0.0], [-second, 1.0]])
    ahead, push = np.array([[1.0, way], [0.0, left]]), np.array([pushed, way])
    error = np.linalg.solve(np.eye(2) - kept @ ahead, kept @ push)
    return way, left, pushed, first, second, 1.0 / float((ahead @ error + push)[0])
