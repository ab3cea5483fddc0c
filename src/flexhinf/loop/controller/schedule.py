"""Several laws, designed at several poses, behind one controller: the nearest to the command is active.

When a law takes over, the input continues from the last one: bumpless transfer.

The integrals are what a law remembers, so they are chosen to make it ask for the input that acts already:
u* + k(x − x*, e) = u_last, by a fixed number of Broyden's steps [broyden1965] from the integrals as they are and
the inverse slope at the operating point. What no integral reaches (a law without integrals, fewer integrals than
inputs, a polynomial without such a root) is held as a bias that decays, so that the input is continuous always.
Every step is one evaluation of the law, so that it may be a polynomial of any degree; composed kernels make them
only when a law takes over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.options import Mode, check_kinds
from flexhinf.plant import Law
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import PolynomialLaw
from flexhinf.scalars import absolute, where
from flexhinf.validation import checked_positive, real_number, value_text

#: Time constant of the bias that decays, s.
FADE = 0.5

#: Broyden's steps. One integral needs about five to a relative 1e-12, far from the operating point too.
STEPS = 10

#: Directions of the integrals whose slope is below this fraction of the largest one are not used.
FLAT = 1e-9

#: Below this fraction of the size of its terms, the divisor of Broyden's update is rounding.
ROUNDING = 1e-14


def blend_time(fade: Any, mode: Mode) -> float:
    """The time constant of the bias, s; refused if it is not positive, or given though no law ever takes over."""
    if fade is not None and not mode.takes_over:
        found = f"expected fade=None for one law that starts from zero, got {value_text(fade)}"
        advice = "start='bumpless', or a Schedule of several laws"
        raise InvalidInput("A time constant is given for a bias that never is.", found, advice)
    return (
        FADE
        if fade is None
        else checked_positive("The time constant of the bias", fade, "seconds", "fade=0.5")
    )


def inverse_slope(slope: np.ndarray) -> np.ndarray:
    """Least-squares inverse (k, m) of ∂u/∂e (m, k) at the operating point."""
    return np.linalg.pinv(slope, rcond=FLAT)


def bumpless_transfer(
    run: Any, law: Callable[[Any], Any], taken: Any, deviation: Any, feedback: Any, wanted: Any, *data: Any
) -> tuple[Any, Any, Any, Any]:
    """The feedback of a sample at which a law may take over.

    Of the law k(x) on the run; `taken` (1,), 1 where a law takes over at this sample, else 0; the law's argument
    (n + k,) with the integrals as they are and k of it; u_last − u* (m,). Behind these the inverse slope (k, m), see
    `inverse_slope`; the growth of the integrals since the last sample (k,); the last bias (m,); x* (n + k,); and the
    fraction of the bias that is left after a period (1,).

    Returns k with the bias (m,); growth and integrals (k,), the growth zero where a law takes over; the bias (m,).
    """
    inverse, growth, bias, point, decay = data
    n = deviation.shape[0] - growth.shape[0]
    misfit, errors = wanted, deviation[n:]
    with run.when(taken):
        misfit = run.call(np.subtract, wanted, feedback)

        def step(errors: Any, misfit: Any, inverse: Any) -> tuple[Any, Any, Any]:
            one_step_on = lambda x, e, inverse, misfit: np.concatenate([x, e + inverse @ misfit])  # noqa: E731
            trial = run.call(one_step_on, deviation[:n], errors, inverse, misfit)
            return run.call(_better, errors, misfit, inverse, trial, law(trial), wanted)

        if growth.shape[0]:
            errors, misfit, _ = run.repeat(STEPS, step, errors, misfit, inverse)
    parts = (taken, feedback, wanted, misfit, errors, growth, bias, deviation, point, decay)
    return run.call(partial(_joined, n), *parts)


def _better(
    errors: Any, misfit: Any, inverse: Any, trial: Any, value: Any, wanted: Any
) -> tuple[Any, Any, Any]:
    """The better of two, and the inverse slope that explains what the step did (Broyden's good update)."""
    step, rest = trial[trial.shape[0] - errors.shape[0] :] - errors, wanted - value
    did = inverse @ (misfit - rest)
    divisor, size = step @ did, absolute(step) @ absolute(did)
    usable = absolute(divisor) > ROUNDING * size
    share = where(usable, 1.0 / where(usable, divisor, 1.0), 0.0)
    better = rest @ rest < misfit @ misfit
    inverse = inverse + np.outer((step - did) * share, step @ inverse)
    return where(better, errors + step, errors), where(better, rest, misfit), inverse


def _joined(n: int, *parts: Any) -> tuple[Any, Any, Any, Any]:
    """What was found where a law takes over, else what was; see `bumpless_transfer`."""
    taken, feedback, wanted, misfit, errors, growth, bias, deviation, point, decay = parts
    new = taken[0] > 0.5
    integral = where(new, errors, deviation[n:]) + point[n:]
    bias = where(new, misfit, decay * bias)
    feedback = where(new, wanted, feedback + bias)
    return feedback, where(new, 0.0, growth), integral, bias


class Schedule(Law):
    """Laws at several poses, of which one is active at a time.

    Active is the law whose operating point's tracked positions are nearest (Euclidean distance) to the command.
    It changes only when another law is nearer by the fraction `hysteresis`: distance < (1 − hysteresis) · distance of
    the active law's. At a change the integrals are chosen so that the input continues from the last one, see
    `flexhinf.loop.controller.schedule`. About a moving reference x_d and u_d are the command's, and only k changes.

    Where one law is needed (names, operating point and input, numbers), it is the first.

    Parameters
    ----------
    laws : sequence of Law
        Of the same states and inputs, and of one formula: solved to the same degree. Degrees that vanish at one
        pose only, by symmetry, do not matter.
    hysteresis : float
        At least 0, below 1.

    Raises
    ------
    InvalidInput
        If the laws do not fit each other, track nothing or share a pose, or the hysteresis is no such number.
    """

    def __init__(self, laws: Sequence[Law], hysteresis: float = 0.1) -> None:
        self.laws = _checked(laws)
        self.hysteresis = real_number(hysteresis)
        if not 0.0 <= self.hysteresis < 1.0:
            raise InvalidInput(
                "The hysteresis of a schedule is no fraction.",
                f"expected 0 <= number < 1, got {value_text(hysteresis)}",
                "hysteresis=0.1: another law must be nearer by 10 %",
            )
        first = self.laws[0]
        self.state_names, self.input_names = tuple(first.state_names), tuple(first.input_names)
        self.operating_point, self.operating_input = first.operating_point, first.operating_input

    def acting(self, pose: Any) -> int:
        """Place of the law that acts at a pose, the nearest in the tracked positions, without hysteresis.

        Parameters
        ----------
        pose : (n,)
            The first states of the laws, such as all link positions, rad or m; at least up to the tracked ones.
        """
        places = [self.state_names.index(name) for name in self.tracked]
        points = np.array([np.asarray(law.operating_point, dtype=float)[places] for law in self.laws])
        return int(np.argmin(np.linalg.norm(points - np.asarray(pose, dtype=float)[places], axis=1)))

    @property
    def law_data(self) -> np.ndarray:
        """Numbers of the first law."""
        return self.laws[0].law_data

    @property
    def law_key(self) -> str:
        """Of the formula that the laws share."""
        return self.laws[0].law_key

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (m,), by the formula that the laws share."""
        return self.laws[0].evaluate_law(x, data)


def chosen(
    run: Any, places: Sequence[int], mode: Mode, r: Any, active: Any, started: Any, data: Any
) -> tuple[Any, ...]:
    """Which law is active at this sample, and its numbers.

    The command r is (k,), or (n + m,) of a moving reference; `places` are those of the tracked states among all states,
    `active` (L,) is 1 for the law that was active, `started` (1,) 0 at the first sample, which knows no active law.

    Returns what is active now (L,); 1 where a law takes over (1,); and of the active law operating point and input,
    gain of the integrals and inverse slope, behind these windup_line and windup_spread where windup is bounded.
    """
    tables = (data.operating_point, data.operating_input, data.integral_gain, data.inverse_slope)
    tables += (data.windup_line, data.windup_spread) if mode.bounds_windup else ()

    def choose(r: Any, active: Any, started: Any, closer: Any, points: Any, *tables: Any) -> tuple[Any, ...]:
        apart = points[:, places] - (r[places] if mode.moving else r)
        distances = (apart * apart).sum(axis=1)
        nearest, index = distances[0], 0.0
        for law, distance in enumerate(distances[1:], 1):
            index = where(distance < nearest, float(law), index)
            nearest = where(distance < nearest, distance, nearest)
        # Squared distances, so squared fractions; the first sample chooses without hysteresis.
        changes = where(started[0] > 0.5, nearest < closer[0] * closer[0] * (active @ distances), True)
        now = np.array([where(changes, where(index == law, 1.0, 0.0), was) for law, was in enumerate(active)])
        taken = where(started[0] > 0.5, 1.0 - active @ now, 1.0 if mode.bumpless else 0.0)
        rows = (np.tensordot(now, table, axes=1) for table in (points, *tables))
        return now, np.array([taken]), *rows

    return run.call(choose, r, active, started, data.closer, *tables)


def _checked(laws: Any) -> tuple[Law, ...]:
    if not isinstance(laws, Sequence) or isinstance(laws, str) or not laws:
        found = f"expected a sequence of laws, got {value_text(laws)}"
        raise InvalidInput("A schedule needs laws.", found, "Schedule([law, other])")
    for law in laws:
        check_kinds(law, None)
    first = laws[0]
    names = [(list(law.state_names), list(law.input_names)) for law in laws]
    for other in names:
        if other != names[0]:
            what = "The laws of a schedule do not mean the same states and inputs."
            raise InvalidInput(
                what, f"expected {names[0]}, got {other}", "laws of one problem at several poses"
            )
    laws = with_common_monomials(laws)
    text, *others = ((type(law), law.law_key, np.size(law.law_data)) for law in laws)
    for other in others:
        if text != other:
            raise InvalidInput(
                "The laws of a schedule share no formula.",
                f"expected {text[0].__name__} {text[1]!r} of {text[2]} numbers, "
                f"got {other[0].__name__} {other[1]!r} of {other[2]}",
                "solve all to the same degree",
            )
    places = [first.state_names.index(name) for name in first.tracked]
    poses = [tuple(np.asarray(law.operating_point, dtype=float)[places].tolist()) for law in laws]
    if not places or len(set(poses)) < len(poses):
        found = f"expected tracked positions that differ, got {[list(pose) for pose in poses]}"
        what = "The poses of a schedule do not tell its laws apart."
        raise InvalidInput(what, found, "laws with integrals, each about a pose of its own")
    return laws


class TableLaw(Law):
    """A law that is the table of its polynomial, with the names and the operating point of another one; `kind` is the
    class that it was, `degree` that of its value function."""

    def __init__(
        self,
        names: Sequence[Sequence[str]],
        point: Any,
        input: Any,
        table: PolynomialLaw,
        kind: str,
        degree: int | None,
    ) -> None:
        self.state_names, self.input_names = map(tuple, names)
        self.operating_point, self.operating_input = point, input
        self.table, self.made_of = table, (kind, degree)

    @property
    def kind(self) -> str:
        """The class that it was."""
        return self.made_of[0]

    @property
    def law_data(self) -> np.ndarray:
        """The coefficients, flat."""
        return self.table.coefficients.ravel()

    @property
    def law_key(self) -> str:
        """The monomials."""
        return f"polynomial {self.table.n} {self.table.degrees}"

    @property
    def law_table(self) -> PolynomialLaw:
        """The polynomial."""
        return self.table

    @property
    def law_degree(self) -> int | None:
        """As of the law that it was."""
        return self.made_of[1]

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (m,), for a deviation x (n,) on any element."""
        return self.table.evaluate(x, np.asarray(data).reshape(self.table.coefficients.shape))


def with_common_monomials(laws: Sequence[Law]) -> tuple[Law, ...]:
    """The laws, padded if they are polynomials of one class, solved to one degree, whose monomials differ."""
    alike = len({(type(law), law.law_degree) for law in laws}) == 1 and laws[0].law_degree is not None
    tables = [table for law in laws if (table := law.law_table) is not None]
    if len({law.law_key for law in laws}) == 1 or not alike or len(tables) < len(laws):
        return tuple(laws)
    degrees = tuple(sorted({degree for table in tables for degree in table.degrees}))
    padded = []
    for law, table in zip(laws, tables):
        own, nothing = iter(table.coefficients.T), np.zeros(len(law.input_names))
        rows = [
            next(own) if degree in table.degrees else nothing
            for degree in degrees
            for _ in range(basis.count(table.n, degree))
        ]
        whole = PolynomialLaw(table.n, degrees, np.array(rows).T)
        names = law.state_names, law.input_names
        padded.append(
            TableLaw(names, law.operating_point, law.operating_input, whole, law.kind, law.law_degree)
        )
    return tuple(padded)
