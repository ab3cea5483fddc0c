"""Interfaces of a law, an estimator and a black box in a closed loop: base classes with few abstract methods.

Rooms that know only these classes can be exchanged freely.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import count
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Element, Elements
from flexhinf.errors import InvalidInput
from flexhinf.notebook import Summarised, names_text
from flexhinf.numerals import number_text
from flexhinf.plant.parameters import Parameters
from flexhinf.plant.plant import GeneralisedPlant, Plant
from flexhinf.plant.series import SpringSeries
from flexhinf.polynomial.algebra import PolynomialLaw
from flexhinf.scalars import absolute, where
from flexhinf.scalars.run import Run

#: A named tuple of arrays that begins with the mean. Each estimator has a kind of its own, whose parts it reads by
#: name, so that the base class cannot say more.
Belief: TypeAlias = Any

#: What the name of the integral of a state's error ends with.
INTEGRAL = "_integral"

_instances = count()


def use_default_form(cls: type, base: type, written: str, form: str) -> None:
    """Where `cls` writes the method `written` but not its other `form`, give it that of `base`.

    A subclass that changes the plain text of a law or an update must not be evaluated by the other form that its
    parent has of the old text.
    """
    if written in vars(cls) and form not in vars(cls):
        setattr(cls, form, vars(base)[form])


def _deviations(covariance: np.ndarray, names: Sequence[str], plant: Plant) -> str:
    """Standard deviations of signals, of each unit from the smallest to the largest."""
    found: dict[str, list[float]] = {}
    for name, size in zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True):
        found.setdefault(plant.unit(name), []).append(size)
    texts = [
        f"{' to '.join(dict.fromkeys(f'{end(sizes):.3g}' for end in (min, max)))} {unit}".rstrip()
        for unit, sizes in found.items()
    ]
    return f"standard deviation {', '.join(texts)}"


class Numbered(Summarised):
    """Base of objects with a number of their own in this process, for keys of their code; copies have another."""

    @cached_property
    def _number(self) -> int:
        return next(_instances)

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "_number"}


class Law(Numbered):
    """A state feedback u = u* + k(x − x*), evaluated on any element.

    A subclass writes `law_data` and `evaluate_law` and has four attributes (or properties); everything else has a
    default. `state_names` are states of the plant, then one integral ``NAME_integral`` per tracked state; the operating
    point is x* (n,), integrals included, and u* (m,).

    Examples
    --------
    u = −k x of a cart, with its gain as data:

    >>> import flexhinf as fh
    >>> import numpy as np
    >>> class Proportional(fh.Law):
    ...     state_names, input_names = ("position", "speed"), ("force",)
    ...     operating_point, operating_input = np.zeros(2), np.zeros(1)
    ...     law_data = np.array([4.0, 2.0])
    ...
    ...     def evaluate_law(self, x, data):
    ...         return np.array([-(data @ x)])
    >>> plant = fh.Plant(
    ...     lambda x, u, d, p: np.array([x[1], u[0]]), lambda x, u, p: x, ("position", "speed"), ("force",),
    ...     outputs=("position", "speed"),
    ... )
    >>> run = fh.Loop(plant, fh.Controller(Proportional(), None, 1e-2)).run(initial_state=[1.0, 0.0])
    >>> bool(abs(run.data.position[-1]) < 1e-3)
    True
    """

    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    operating_point: np.ndarray
    operating_input: np.ndarray

    def __init_subclass__(cls, **arguments: object) -> None:
        super().__init_subclass__(**arguments)
        for form in ("law_table", "evaluate_about", "law_key"):
            use_default_form(cls, Law, "evaluate_law", form)
        use_default_form(cls, Law, "evaluate_about", "law_series")

    def summary(self) -> dict[str, str]:
        """States, inputs, what is tracked, and how many numbers there are."""
        return {
            "states": names_text(self.plant_states),
            "inputs": names_text(tuple(self.input_names)),
            "tracked": names_text(self.tracked),
            "numbers": str(np.size(self.law_data)),
        }

    @property
    def kind(self) -> str:
        """Name of the law's class for readers; of a stored law, the class that was stored."""
        return type(self).__name__

    # To be written --------------------------------------------------------------------------------
    @property
    @abc.abstractmethod
    def law_data(self) -> np.ndarray:
        """Numbers of the law, flat. They are data of a kernel: another γ compiles nothing."""

    @abc.abstractmethod
    def evaluate_law(self, x: Elements, data: Elements) -> Elements:
        """k(x), (m,), for a deviation x (n,) of numbers or of any element, with the numbers as in `law_data`."""

    # Defaults -------------------------------------------------------------------------------------
    @property
    def law_key(self) -> str:
        """What distinguishes the code of two laws of one class (not their data).

        By default each law has code of its own. A class whose `evaluate_law` depends on nothing but `data` and the
        names returns a constant, so that all its laws share one kernel.
        """
        return f"law {self._number}"

    @property
    def law_table(self) -> PolynomialLaw | None:
        """The polynomial that `evaluate_law` computes, with `law_data` as its coefficients; None if it is none.

        Kernels evaluate a large polynomial in loops; without it, `evaluate_law` is traced.
        """
        return None

    @property
    def law_series(self) -> SpringSeries | None:
        """The series that `evaluate_about` computes, with its numbers first in `law_data`, and x* and u* last; None if
        it is none. Kernels and exported C evaluate its springs in a loop."""
        return None

    @property
    def law_degree(self) -> int | None:
        """Degree of the value function that the law was solved to; None for a law of no value function."""
        return None

    def evaluate_about(self, x: Elements, state: Elements, input: Elements, data: Elements) -> Elements:
        """k(x), (m,), for a deviation x (n,), integrals last, from a moving reference: its state and input.

        A law that depends on where it acts overrides this: then u = input + k, k = 0 for x = 0, and `evaluate_law` is
        the same about (x*, u*). By default k is a function of the deviation alone.
        """
        return self.evaluate_law(x, data)

    @property
    def depends_on_reference(self) -> bool:
        """Whether the class writes `evaluate_about`."""
        return type(self).evaluate_about is not Law.evaluate_about

    @property
    def plant_states(self) -> tuple[str, ...]:
        """State names without integrals."""
        return tuple(name for name in self.state_names if not name.endswith(INTEGRAL))

    @property
    def tracked(self) -> tuple[str, ...]:
        """States whose tracking error the law integrates."""
        return tuple(name.removesuffix(INTEGRAL) for name in self.state_names if name.endswith(INTEGRAL))


class ProblemLaw(Law):
    """Base of laws that stand for a `GeneralisedPlant`: names and operating point are the problem's."""

    problem: GeneralisedPlant
    state_names: Any = property(attrgetter("problem.state_names"))
    input_names: Any = property(attrgetter("problem.input_names"))
    operating_point: Any = property(attrgetter("problem.operating_point"))
    operating_input: Any = property(attrgetter("problem.operating_input"))


def known(y: Elements) -> Elements:
    """1 for every element of a measurement (p,) that is a finite number, else 0: that sensor gave nothing."""
    return np.array([where(absolute(element) < np.inf, 1.0, 0.0) for element in y])


def chosen(flags: Elements, those: Elements | float, others: Elements | float) -> Elements:
    """Elements of `those` where flags (p,) are 1, and of `others` where they are 0."""
    on = (
        np.greater(flags, 0.5, dtype=object) if np.asarray(flags).dtype == object else np.asarray(flags) > 0.5
    )
    return where(on, those, others)


def turned(
    signals: Elements | Sequence[Element], about: Elements | Sequence[Element], places: Sequence[int]
) -> Elements:
    """Signals (k,) whose angles, at these places, differ from those of others (k,) by (−π, π]: by whole turns more."""
    moved: Elements = np.array(signals)
    for place in places:
        away = (moved[place] - about[place]) / (2.0 * np.pi)
        moved[place] = moved[place] + 2.0 * np.pi * np.floor(0.5 - away)
    return moved


#: Standard deviations, and parts of variances, by which rounding may move an estimate that is not in doubt.
CLOSE = 1e-3


def rcond_limit(eps: float) -> float:
    """Reciprocal condition of a correction below which the estimate is in doubt, in numbers with the unit roundoff
    2 `eps`: rounding then moves it by more than `CLOSE` standard deviations."""
    return eps / CLOSE


class Gaussian(NamedTuple):
    """A belief about the state: mean (n,) and covariance (n, n), of numbers or of any element.

    Examples
    --------
    >>> import flexhinf as fh
    >>> belief = fh.Gaussian([0.0, 1.0], [[0.1, 0.0], [0.0, 0.2]])
    >>> belief.mean
    [0.0, 1.0]
    """

    mean: Elements
    covariance: Elements


class Estimator(Numbered):
    """A recursive estimator as pure functions of frozen beliefs about the states of a plant, the model it believes in.

    A subclass writes `initial_at`, `time_update` and `measurement_update`, and has five attributes. The period between
    two samples is in s; process and measurement noise are R^v (n, n) and R^n (p, p); `initial` is x(0|−1), or a named
    tuple that begins with the mean. Where that has a part `rcond` (1,), the reciprocal condition of the last correction
    (see `rcond_limit`), a controller says and counts when its estimate is in doubt.

    Examples
    --------
    An estimator that believes what it measures, of a plant whose only state is measured:

    >>> import flexhinf as fh
    >>> import numpy as np
    >>> class Believer(fh.Estimator):
    ...     def __init__(self, plant, period):
    ...         self.plant, self.period = plant, period
    ...         self.process_noise, self.measurement_noise = np.eye(1), np.eye(1)
    ...         self.initial = fh.Gaussian(np.zeros(1), np.eye(1))
    ...
    ...     def initial_at(self, mean):
    ...         return fh.Gaussian(mean, self.initial.covariance)
    ...
    ...     def time_update(self, belief, u, p, process_noise):
    ...         return belief
    ...
    ...     def measurement_update(self, belief, y, u, p, measurement_noise):
    ...         return fh.Gaussian(y, measurement_noise)
    >>> plant = fh.Plant(lambda x, u, d, p: u, lambda x, u, p: x, ("x",), ("u",), outputs=("x",))
    >>> believer = Believer(plant, 1e-2)
    >>> believer.measurement_update(believer.initial, [0.3], [0.0], None, np.eye(1)).mean
    [0.3]
    """

    plant: Plant
    period: float
    process_noise: np.ndarray
    measurement_noise: np.ndarray
    initial: Belief

    def __init_subclass__(cls, **arguments: object) -> None:
        super().__init_subclass__(**arguments)
        for written in ("time_update", "measurement_update"):
            use_default_form(cls, Estimator, written, f"{written}_on")
            use_default_form(cls, Estimator, written, "estimator_key")

    def summary(self) -> dict[str, str]:
        """Model, period and noises."""
        plant = self.plant
        return {
            "states": names_text(tuple(self.plant.states)),
            "measured": names_text(tuple(self.plant.outputs)),
            "period": number_text(self.period, "s"),
            "process noise": f"{_deviations(self.process_noise, plant.states, plant)} per sample",
            "measurement noise": _deviations(self.measurement_noise, plant.outputs, plant),
        }

    # To be written --------------------------------------------------------------------------------
    @abc.abstractmethod
    def initial_at(self, mean: ArrayLike) -> Belief:
        """The initial belief with another mean (n,)."""

    @abc.abstractmethod
    def time_update(self, belief: Belief, u: Elements, p: Parameters, process_noise: Elements) -> Belief:
        """x(k|k) → x(k+1|k), pure, on any element; p has the parameters as attributes."""

    @abc.abstractmethod
    def measurement_update(
        self, belief: Belief, y: Elements, u: Elements, p: Parameters, measurement_noise: Elements
    ) -> Belief:
        """x(k|k−1) → x(k|k), pure, as `time_update`. Every element of y is a number, see `measurement_update_on`."""

    # Defaults -------------------------------------------------------------------------------------
    @property
    def estimator_key(self) -> str:
        """What distinguishes the code of two estimators of one class (not their data); by default each its own."""
        return f"estimator {self._number}"

    def settings(self) -> dict[str, object]:
        """Arguments that make this estimator again: numbers, arrays, texts, a Plant or another Estimator by name.

        By default it is refused: an estimator that does not state them cannot be saved.
        """
        raise InvalidInput(
            f"{type(self).__name__} cannot be saved.",
            "expected an estimator that returns its arguments from settings()",
            "an estimator of flexhinf.estimation",
        )

    @property
    def operations(self) -> int:
        """Estimated number of operations of both updates as one trace; 0 keeps them one trace."""
        return 0

    def time_update_on(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """`time_update` on a run (`flexhinf.codegen.Direct` or `Composer`), p the vector of parameters.

        By default it is one traced piece. An estimator of many states composes it of pieces in loops.
        """
        return self._update_on(run, self.time_update, belief, p, process_noise, u)

    def measurement_update_on(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> Belief:
        """`measurement_update` on a run, as `time_update_on`. Here elements of y may be no finite numbers: their
        sensors gave nothing. By default they become what the model expects, so that they move no estimate."""

        def update(belief: Belief, y: Elements, u: Elements, p: Parameters, noise: Elements) -> Belief:
            expected = self.plant.evaluate_output(belief[0], u, self.plant.parameters.flat(p))
            return self.measurement_update(belief, self.completed(y, expected), u, p, noise)

        return self._update_on(run, update, belief, p, measurement_noise, y, u)

    def completed(self, y: Elements, expected: Elements) -> Elements:
        """A measurement (p,), with what is expected (p,) where an element is missing; angles as in `unwound`."""
        return chosen(known(y), self.unwound(y, expected), expected)

    def unwound(self, y: Elements, about: Elements) -> Elements:
        """A measurement (p,) whose angles have as many whole turns more as bring them nearest to others (p,)."""
        return turned(y, about, self.plant.angle_places(self.plant.outputs))

    def _update_on(
        self,
        run: Run,
        written: Callable[..., Belief],
        belief: Belief,
        p: Elements,
        noise: Elements,
        *values: Elements,
    ) -> Belief:
        kind = cast(Callable[..., Belief], type(belief))
        count, named = len(values), self.plant.parameters.named

        def update(*arguments: Elements) -> tuple[Elements, ...]:
            p, noise, *parts = arguments[count:]
            return tuple(written(kind(*parts), *arguments[:count], named(p), noise))

        return kind(*run.call(update, *values, p, noise, *belief))


class BlackBox(abc.ABC):
    """A true plant that integrates itself, such as a physics engine.

    A subclass writes `reset`, `step` and `output`. It may also have names, so that disturbances are commanded and the
    true state is recorded: channels of the disturbance, what `state` returns, units, groups (see `flexhinf.Plant`) and
    limits, the range of a state, by name.

    Examples
    --------
    A motor whose speed follows its input with a lag of a second:

    >>> import flexhinf as fh
    >>> class Motor(fh.BlackBox):
    ...     def reset(self, initial_state):
    ...         self.speed = 0.0
    ...
    ...     def step(self, u, disturbance, period):
    ...         self.speed += period * (u[0] - self.speed)
    ...
    ...     def output(self):
    ...         return [self.speed]
    >>> motor = Motor()
    >>> motor.reset(None)
    >>> motor.step([1.0], [], 0.1)
    >>> motor.output()
    [0.1]
    """

    disturbances: tuple[str, ...] = ()
    states: tuple[str, ...] = ()
    units: Mapping[str, str] = {}
    groups: Mapping[str, tuple[str, ...]] = {}
    limits: Mapping[str, tuple[float, float]] = {}

    @abc.abstractmethod
    def reset(self, initial_state: np.ndarray | None) -> None:
        """Start again, at the equilibrium by default."""

    @abc.abstractmethod
    def step(self, u: np.ndarray, disturbance: np.ndarray, period: float) -> None:
        """Advance by one period with the input and the disturbance held."""

    @abc.abstractmethod
    def output(self) -> np.ndarray:
        """The measured signals, or the state that the law was designed for if there is no estimator."""

    def state(self) -> np.ndarray:
        """The true state, one number for each of `states`."""
        return np.zeros(0)
