"""One step of a controller whose estimator has come to rest, with its derivatives, for many rows at once.

The same step as `flexhinf.loop.controller.step.controller_step` (correct, integrate, law, predict), without
limits of the input, put together from its parts by the chain rule: a derivative costs matrix products, not a trace
of the whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis.batch import LawRows, Rows
from flexhinf.errors import InvalidInput
from flexhinf.estimation import ConstantGainFilter, OutputInjectionObserver, RecursiveFilter
from flexhinf.loop import Controller
from flexhinf.plant import Law
from flexhinf.scalars import trace


@dataclass(frozen=True)
class Dual:
    """Values (N, k) and their derivatives by w variables, (N, k, w)."""

    value: np.ndarray
    by: np.ndarray

    def __add__(self, other: Dual) -> Dual:
        return Dual(self.value + other.value, self.by + other.by)

    def __sub__(self, other: Dual) -> Dual:
        return Dual(self.value - other.value, self.by - other.by)

    def __getitem__(self, part: slice) -> Dual:
        return Dual(self.value[:, part], self.by[:, part])

    def times(self, factor: np.ndarray) -> Dual:
        """Each row by a number, (N,)."""
        return Dual(factor[:, None] * self.value, factor[:, None, None] * self.by)

    def moved(self, matrix: np.ndarray) -> Dual:
        """By a constant matrix (j, k)."""
        return Dual(self.value @ matrix.T, matrix @ self.by)

    def through(self, function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Dual:
        """f of it, for an f that gives values (N, j) and slopes (N, j, k)."""
        value, slope = function(self.value)
        return Dual(value, slope @ self.by)


def stacked(*parts: Dual) -> Dual:
    """The entries of all parts in one vector per row."""
    return Dual(np.hstack([p.value for p in parts]), np.concatenate([p.by for p in parts], axis=1))


def model_rows(filter: RecursiveFilter) -> Rows:
    """One sub-step of a filter's model: (x, u), parameters → (x, u) after it; `filter.sub_steps` make F."""
    n, m, size = filter.plant.n, len(filter.plant.inputs), filter.plant.parameters.size

    def once(moving: Any, held: Any) -> Any:
        return np.concatenate([np.asarray(filter.sub_step(moving[:n], moving[n:], held)), moving[n:]])

    key = ("model", filter.period, filter.sub_steps, filter.stages, filter.plant.code_key)
    return Rows(key, lambda: trace(once, n + m, size, name="model"), repeated=True)


@dataclass(frozen=True)
class Stepped:
    """One step: input (N, m), the law's argument (N, n + k), and the memory for the next step (N, s); derivatives are
    by memory (s), measurement (p), command (k) and centre (n + k, m), in this order."""

    u: Dual
    deviation: Dual
    memory: Dual


class SampledController:
    """A law with an estimator of constant gain, or fed back the state.

    The memory is what moves of the estimator's belief (x̂(k|k−1), or nothing without an estimator), the last input,
    the integrals, and the tracked positions of the last sample (their errors, where the reference moves). The centre
    is (x*, u*): of the law, or the moving reference.

    The estimator has a constant gain: a ConstantGainFilter, an OutputInjectionObserver, or another of whose belief
    nothing but the mean moves, else an InvalidInput; or there is None. `moving` is as of `flexhinf.loop.Controller`.
    """

    def __init__(self, law: Law, estimator: Any, period: float, moving: bool = False) -> None:
        self.law, self.estimator, self.period, self.moving = law, estimator, period, moving
        self.controller = Controller(law, estimator, period, moving=moving)
        self.states, self.tracked = self.controller.states, self.controller.tracked
        self.measured = self.controller.measured
        self.n, self.m, self.k = len(self.states), len(law.input_names), len(self.tracked)
        self.p = len(self.measured)
        self.law_rows = LawRows(law)
        #: Parts of the belief that move though the gain does not; each has the size of the state, the mean is first.
        self.parts: tuple[int, ...] = () if estimator is None else (0,)
        if isinstance(estimator, OutputInjectionObserver):
            fields = type(estimator.initial)._fields
            self.parts = tuple(fields.index(name) for name in ("mean", "measured", "injection"))
        if self.parts == (0,) and estimator is not None:
            u, mean = (
                np.asarray(law.operating_input, dtype=float),
                np.asarray(estimator.initial.mean, dtype=float),
            )
            y, held = (
                estimator.plant.evaluate_output(mean, u, estimator.plant.parameters.vector()),
                self._held(None),
            )
            for given in ((y, u), (u,)):
                belief = self._updated(np.concatenate([mean, *given]), held, len(given) == 2)
                for new, old in zip(belief[1:], estimator.initial[1:]):
                    if not np.array_equal(np.asarray(new, dtype=float), np.asarray(old, dtype=float)):
                        raise InvalidInput(
                            "The estimator's gain does not stand still.",
                            f"expected a belief of which only the mean moves, got {type(estimator).__name__}",
                            "ConstantGainFilter(filter, stationary_gain(...))",
                        )

    @property
    def centre(self) -> np.ndarray:
        """(x*, u*) of the law, (n + k + m,)."""
        return np.concatenate([self.law.operating_point, self.law.operating_input])

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where the parts of the memory are."""
        sizes = {"belief": self.n * len(self.parts), "u": self.m, "integral": self.k, "position": self.k}
        ends = np.cumsum([*sizes.values()]).tolist()
        return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends)}

    @property
    def size(self) -> int:
        """Length of the memory."""
        return self.places["position"].stop

    def step(
        self,
        memory: np.ndarray,
        y: np.ndarray,
        command: np.ndarray,
        centre: np.ndarray | None = None,
        fixed: np.ndarray | None = None,
        started: Any = 1.0,
        outside: bool = True,
    ) -> Stepped:
        """One step for N rows of memory (N, s), measurement (N, p) and command (N, k) of the tracked positions: over
        the interval that ends now, or at this sample of a moving reference.

        The centre (n + k + m,) is the law's by default. `fixed` (j,) or (N, j) is what stands still of the belief (the
        gain), instead of the estimator's own, for all rows or for each. `started`, one number or (N,), is 0 at the
        first sample of a run, which has no interval behind it; `outside` says whether derivatives by command and
        centre are wanted too.
        """
        count, place = len(memory), self.places
        point = np.broadcast_to(self.centre if centre is None else centre, (count, self.n + self.k + self.m))
        given = (memory, y, command, point)
        unit = np.eye(sum(value.shape[1] for value in given))[:, : None if outside else self.size + self.p]
        rows = np.split(unit, np.cumsum([value.shape[1] for value in given])[:-1])
        past, seen, wanted, about = (
            Dual(value, np.broadcast_to(row, (count, *row.shape))) for value, row in zip(given, rows)
        )
        estimate = belief = seen
        if self.estimator is not None:
            held = self._held(fixed)
            if self._flag.stop:
                held = np.tile(held, (count, 1))
                held[:, self._flag] = np.broadcast_to(started, (count,))[:, None]
            before = stacked(past[place["belief"]], seen, past[place["u"]])
            belief = before.through(lambda v: self._correct(v, held))
            estimate = belief[: self.n]
        # Tracked positions: the measurement where there is one, else the estimate.
        from_y, from_state = np.zeros((self.k, self.p)), np.zeros((self.k, self.n))
        for row, name in enumerate(self.tracked):
            if name in self.measured:
                from_y[row, self.measured.index(name)] = 1.0
            else:
                from_state[row, self.states.index(name)] = 1.0
        position = seen.moved(from_y) + estimate.moved(from_state)
        half = 0.5 * self.period * np.broadcast_to(started, (count,))
        if self.moving:  # position stands for its error, before and now
            position = position - wanted
        growth = (past[place["position"]] + position).times(half)
        integral = past[place["integral"]] + (growth if self.moving else growth - wanted.times(2.0 * half))
        deviation = stacked(estimate, integral) - about[: self.n + self.k]
        rest = about[self.n + self.k :]
        if self.moving and self.law.depends_on_reference:
            u = rest + stacked(deviation, about[: self.n], rest).through(self.law_rows.about)
        else:
            u = rest + deviation.through(self.law_rows)
        after = stacked(u, integral, position)
        if self.estimator is not None:
            after = stacked(stacked(belief, u).through(lambda v: self._predict(v, held)), after)
        return Stepped(u, deviation, after)

    # The estimator -------------------------------------------------------------------------------------
    def _held(self, fixed: np.ndarray | None) -> np.ndarray:
        """What the estimator's updates are made of: parameters, and what stands still of the belief; (j,) or (N, j)."""
        if fixed is not None and fixed.ndim == 2:
            return np.hstack([np.tile(self.estimator.plant.parameters.vector(), (len(fixed), 1)), fixed])
        initial = self.estimator.initial
        still = [part for k, part in enumerate(initial) if k not in self.parts] if fixed is None else [fixed]
        held = np.concatenate([self.estimator.plant.parameters.vector(), *map(np.ravel, still)])
        held[self._flag] = 1.0
        return held

    @cached_property
    def _flag(self) -> slice:
        """Where an observer is told, in `_held`, that a period lies before its measurement; empty for others."""
        place = self.estimator.plant.parameters.size
        for k, (name, part) in enumerate(zip(self.estimator.initial._fields, self.estimator.initial)):
            if name == "moved":
                return slice(place, place + 1)
            place += 0 if k in self.parts else int(np.size(part))
        return slice(0, 0)

    def _belief(self, moving: Any, still: Any) -> Any:
        parts, rest = [], {True: moving, False: still}
        for k, part in enumerate(self.estimator.initial):
            size, moves = int(np.size(part)), k in self.parts
            parts.append(rest[moves][:size].reshape(np.shape(part)))
            rest[moves] = rest[moves][size:]
        return type(self.estimator.initial)(*parts)

    def _moved(self, belief: Any) -> Any:
        return np.concatenate([np.ravel(np.asarray(belief[k])) for k in self.parts])

    def _updated(self, moving: Any, held: Any, measured: bool) -> Any:
        e, size, n = self.estimator, self.estimator.plant.parameters.size, self.places["belief"].stop
        p, belief, u = (
            e.plant.parameters.named(held[:size]),
            self._belief(moving[:n], held[size:]),
            moving[n:],
        )
        if measured:
            return e.measurement_update(belief, u[: self.p], u[self.p :], p, e.measurement_noise)
        return e.time_update(belief, u, p, e.process_noise)

    def settled(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """What moves of the belief, where the estimator's plant rests at (x, u)."""
        if self.estimator is None:
            return np.zeros(0)
        e, held = self.estimator, self._held(None)
        y = e.plant.evaluate_output(x, u, e.plant.parameters.vector())
        moving = self._moved(e.initial_at(x))
        for given in ((u,), (y, u), (u,)):
            moving = self._moved(self._updated(np.concatenate([moving, *given]), held, len(given) == 2))
        return np.concatenate([x, moving[self.n :]])

    def beliefs(self, y: np.ndarray, u: np.ndarray, estimate: np.ndarray, last: np.ndarray) -> np.ndarray:
        """What moves of the belief before each of N samples of a run that began with the estimator's own, by what was
        measured (N, p), given (N, m), estimated x̂(k|k) (N, n), and given one sample before (N, m)."""
        if self.estimator is None:
            return np.zeros((len(u), 0))
        held, moving = self._held(None), self._moved(self.estimator.initial)[None, :]
        if self.parts == (0,):
            return np.vstack([moving, self._predict(np.hstack([estimate, u]), held)[0][:-1]])
        beliefs = [moving]
        for k in range(len(u) - 1):
            held[self._flag] = float(k > 0)
            corrected = self._correct(np.hstack([beliefs[-1], y[k : k + 1], last[k : k + 1]]), held)[0]
            beliefs.append(self._predict(np.hstack([corrected, u[k : k + 1]]), held)[0])
        return np.vstack(beliefs)

    def _update_rows(self, name: str, measured: bool) -> Rows:
        e, given = self.estimator, self.p + self.m if measured else self.m
        sizes = (self.places["belief"].stop + given, self._held(None).size)
        update = lambda moving, held: self._moved(self._updated(moving, held, measured))  # noqa: E731
        key = (name, type(e), e.estimator_key, e.plant.code_key)
        return Rows(key, lambda: trace(update, *sizes, name=name))

    @cached_property
    def _correct(self) -> Rows:
        return self._update_rows("correct", True)

    @cached_property
    def _predict(self) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """(belief at k|k, u), held → belief at k+1|k, and its slope."""
        e, n = self.estimator, self.n
        if not isinstance(e, ConstantGainFilter):
            return self._update_rows("predict", False)
        rows, size = model_rows(e.filter), e.plant.parameters.size  # sub-steps are a loop, not one trace

        def looped(moving: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            after, slope = rows(moving, held[..., :size], e.filter.sub_steps)
            return after[:, :n], slope[:, :n]

        return looped
