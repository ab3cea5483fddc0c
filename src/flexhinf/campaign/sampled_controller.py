"""One step of a controller whose estimator has come to rest, with its derivatives, for many rows at once.

The same step as `flexhinf.loop.step.controller_step` (correct, integrate, law, predict), without limits of the
input, put together from its parts by the chain rule: a derivative costs matrix products, not a trace of the whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.campaign.dual import Dual, stacked, variables
from flexhinf.campaign.law_rows import LawRows
from flexhinf.campaign.rows import Rows
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ConstantGainFilter, RecursiveFilter
from flexhinf.loop import Controller
from flexhinf.plant import Law
from flexhinf.scalars import trace

__all__ = ["SampledController", "Stepped", "model_rows"]


def model_rows(filter: RecursiveFilter) -> Rows:
    """One sub-step of a filter's model: (x, u), parameters → (x, u) after it; `filter.sub_steps` make F."""
    n, m, size = filter.plant.n, len(filter.plant.inputs), filter.plant.parameters.size

    def once(moving: Any, held: Any) -> Any:
        return np.concatenate([np.asarray(filter.sub_step(moving[:n], moving[n:], held)), moving[n:]])

    key = ("model", filter.period, filter.sub_steps, filter.plant.code_key)
    return Rows(key, lambda: trace(once, n + m, size, name="model"), repeated=True)


@dataclass(frozen=True)
class Stepped:
    """One step; derivatives are by memory (s), measurement (p), command (k) and centre (n + k, m), in this order.

    Attributes
    ----------
    u : Dual, (N, m)
    deviation : Dual, (N, n + k)
        The law's argument.
    memory : Dual, (N, s)
        For the next step.
    """

    u: Dual
    deviation: Dual
    memory: Dual


class SampledController:
    """A law with an estimator of constant gain, or fed back the state.

    The memory is x̂(k|k−1), the last input, the integrals, and the tracked positions of the last sample (their
    errors, where the reference moves); without an estimator the first is missing. The centre is (x*, u*): of the
    law, or the moving reference.

    Parameters
    ----------
    law : Law
    estimator : Estimator or None
        Of whose belief nothing but the mean moves: `flexhinf.estimation.ConstantGainFilter`.
    period : float
        s.
    moving : bool
        As of `flexhinf.loop.Controller`.

    Raises
    ------
    InvalidInput
        If more than the mean moves.
    """

    def __init__(self, law: Law, estimator: Any, period: float, moving: bool = False) -> None:
        self.law, self.estimator, self.period, self.moving = law, estimator, period, moving
        self.controller = Controller(law, estimator, period, moving=moving)
        self.states, self.tracked = self.controller.states, self.controller.tracked
        self.measured = self.controller.measured
        self.n, self.m, self.k = len(self.states), len(law.input_names), len(self.tracked)
        self.p = len(self.measured)
        self.law_rows = LawRows(law)
        if estimator is not None:
            self._check_rest()

    @property
    def centre(self) -> np.ndarray:
        """(x*, u*) of the law, (n + k + m,)."""
        return np.concatenate([self.law.operating_point, self.law.operating_input])

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where the parts of the memory are."""
        sizes = {"mean": 0 if self.estimator is None else self.n, "u": self.m, "integral": self.k}
        places, start = {}, 0
        for name, size in {**sizes, "position": self.k}.items():
            places[name], start = slice(start, start + size), start + size
        return places

    @property
    def size(self) -> int:
        """Length of the memory."""
        return self.places["position"].stop

    @cached_property
    def selection(self) -> tuple[np.ndarray, np.ndarray]:
        """Tracked positions as (k, p) of y plus (k, n) of the estimate: the measurement where there is one."""
        by_y, by_state = np.zeros((self.k, self.p)), np.zeros((self.k, self.n))
        for row, name in enumerate(self.tracked):
            if name in self.measured:
                by_y[row, self.measured.index(name)] = 1.0
            else:
                by_state[row, self.states.index(name)] = 1.0
        return by_y, by_state

    # The step ------------------------------------------------------------------------------------------
    def step(
        self,
        memory: np.ndarray,
        y: np.ndarray,
        command: np.ndarray,
        centre: np.ndarray | None = None,
        fixed: np.ndarray | None = None,
        started: Any = 1.0,
    ) -> Stepped:
        """One step for N rows.

        Parameters
        ----------
        memory, y : (N, s) and (N, p) arrays
        command : (N, k) array
            Of the tracked positions: over the interval that ends now, or at this sample of a moving reference.
        centre : (n + k + m,) array, optional
            The law's by default.
        fixed : array, optional
            The belief beyond its mean (the gain), instead of the estimator's own.
        started : float or (N,) array
            0 at the first sample of a run, which has no interval behind it.
        """
        count, place = len(memory), self.places
        point = np.broadcast_to(self.centre if centre is None else centre, (count, self.n + self.k + self.m))
        past, seen, wanted, about = variables(memory, y, command, point)
        held = self._held(fixed)
        estimate = seen
        if self.estimator is not None:
            corrected = stacked(past[place["mean"]], seen, past[place["u"]])
            estimate = corrected.through(lambda v: self._correct(v, held))
        from_y, from_state = self.selection
        position = seen.moved(from_y) + estimate.moved(from_state)
        half = 0.5 * self.period * np.broadcast_to(started, (count,))
        if self.moving:  # position stands for its error, before and now
            position = position - wanted
        growth = (past[place["position"]] + position).times(half)
        integral = past[place["integral"]] + (growth if self.moving else growth - wanted.times(2.0 * half))
        deviation = stacked(estimate, integral) - about[: self.n + self.k]
        u = about[self.n + self.k :] + deviation.through(self.law_rows)
        after = stacked(u, integral, position)
        if self.estimator is not None:
            after = stacked(stacked(estimate, u).through(lambda v: self._predict(v, held)), after)
        return Stepped(u, deviation, after)

    # The estimator -------------------------------------------------------------------------------------
    def _held(self, fixed: np.ndarray | None) -> np.ndarray:
        """What the estimator's updates are made of: parameters, and the belief beyond its mean."""
        if self.estimator is None:
            return np.zeros(0)
        parts = self.estimator.initial[1:] if fixed is None else (fixed,)
        return np.concatenate([self.estimator.plant.parameters.vector(), *map(np.ravel, parts)])

    def _belief(self, mean: Any, fixed: Any) -> Any:
        initial, parts, start = self.estimator.initial, [], 0
        for part in initial[1:]:
            parts.append(fixed[start : start + np.size(part)].reshape(np.shape(part)))
            start += np.size(part)
        return type(initial)(mean, *parts)

    def corrected(self, moving: Any, held: Any) -> Any:
        """The belief after the measurement; moving: (mean, y, u)."""
        e, n, size = self.estimator, self.n, self.estimator.plant.parameters.size
        y, u, p = moving[n : n + self.p], moving[n + self.p :], e.plant.parameters.named(held[:size])
        return e.measurement_update(self._belief(moving[:n], held[size:]), y, u, p, e.measurement_noise)

    def predicted(self, moving: Any, held: Any) -> Any:
        """The belief after a period; moving: (mean, u)."""
        e, n, size = self.estimator, self.n, self.estimator.plant.parameters.size
        p = e.plant.parameters.named(held[:size])
        return e.time_update(self._belief(moving[:n], held[size:]), moving[n:], p, e.process_noise)

    @property
    def _key(self) -> tuple[object, ...]:
        e = self.estimator
        return type(e), e.estimator_key, e.plant.code_key

    @cached_property
    def _correct(self) -> Rows:
        sizes = (self.n + self.p + self.m, self._held(None).size)
        update = lambda moving, held: self.corrected(moving, held).mean  # noqa: E731
        return Rows(("correct", *self._key), lambda: trace(update, *sizes, name="correct"))

    @cached_property
    def _predict(self) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """(x̂(k|k), u), held → x̂(k+1|k) and its slope."""
        e, n, m = self.estimator, self.n, self.m
        if isinstance(e, ConstantGainFilter):  # sub-steps are a loop, not one trace
            rows, size = model_rows(e.filter), e.plant.parameters.size

            def looped(moving: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                after, slope = rows(moving, held[:size], e.filter.sub_steps)
                return after[:, :n], slope[:, :n]

            return looped
        update = lambda moving, held: self.predicted(moving, held).mean  # noqa: E731
        sizes = (n + m, self._held(None).size)
        return Rows(("predict", *self._key), lambda: trace(update, *sizes, name="predict"))

    def _check_rest(self) -> None:
        e, u = self.estimator, np.asarray(self.law.operating_input, dtype=float)
        held, mean = self._held(None), np.asarray(e.initial.mean, dtype=float)
        y = np.atleast_1d(e.plant.output(mean, u, e.plant.parameters.named(held[: e.plant.parameters.size])))
        after = (
            self.corrected(np.concatenate([mean, y, u]), held),
            self.predicted(np.concatenate([mean, u]), held),
        )
        for belief in after:
            for new, old in zip(belief[1:], e.initial[1:]):
                if not np.array_equal(np.asarray(new, dtype=float), np.asarray(old, dtype=float)):
                    raise InvalidInput(
                        "The estimator's gain does not stand still.",
                        f"expected a belief of which only the mean moves, got {type(e).__name__}",
                        "ConstantGainFilter(filter, stationary_gain(...))",
                    )
