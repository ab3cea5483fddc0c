"""Both updates of a filter as machine code, for `predict` and `correct`: the same text, composed to two programs.

NumPy makes the first calls of a filter, as compiling takes as long as many of them. After that a call copies a vector,
runs a program on arrays of its own, and looks at one number. A program changes its arrays only where all is well: for
whatever is not, an entry of `diagnosis` or an error, NumPy makes the call, from the same belief.
"""

# The compiled updates are those of a filter, from what that keeps.
# pyright: reportPrivateUsage=false

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.codegen import Block, Buffer, Composer, Copy, Guard, Kernel, Program, Slice, compile_program
from flexhinf.codegen.shared import share
from flexhinf.estimation.diagnosis import EPS, innovation_limit
from flexhinf.estimation.interface import Filter
from flexhinf.plant import known, rcond_limit
from flexhinf.plant.protocols import Belief
from flexhinf.scalars import absolute, solve_lower, where

#: How a program ends, beside 0: nothing was measured; something is not finite, or digits are lost.
EMPTY, UNUSUAL = 1, 2

#: Reciprocal condition of a correction below which digits are lost.
RCOND_LIMIT = rcond_limit(EPS)

_LOGGER = logging.getLogger("flexhinf.estimation")


class CompiledUpdates:
    """The updates of one filter on a belief, an input and counts of their own.

    `predict`, `correct`: take an input (m,) or a measurement (p,), and return whether the update was made. What does
    not fit is refused by the filter's own error.
    """

    def __init__(self, filter: Filter) -> None:
        plant, initial = filter.plant, filter.initial
        self.kind: type[Belief] = type(initial)
        self.shapes = [np.shape(part) for part in initial]
        self.key = code_key(filter)
        kernels = share(self.key, lambda: tuple(compile_program(program(filter)) for program in PROGRAMS))
        n, m, p = plant.n, len(plant.inputs), len(plant.outputs)
        size = sum(map(math.prod, self.shapes))
        sizes = {"belief": size, "input": m, "u": m, "y": p, "q": n * n, "r": p * p, "counts": 2, "facts": 2}
        self.arrays = {name: np.zeros(number) for name, number in sizes.items()}
        self.arrays["parameters"] = np.zeros(plant.parameters.size)
        runs = [self._bound(kernel) for kernel in kernels]
        self.predict, self.correct = self._updates(filter, *runs)
        self.step, self.skipped, self.repairs = 0, 0, dict[str, int]()

    def _bound(self, kernel: Kernel) -> Callable[[], int]:
        names = [buffer.name for buffer in kernel.program.buffers if buffer.role != "work"]
        return kernel.bind({name: self.arrays[name] for name in names}, {}, short=True)

    def _updates(
        self, filter: Filter, run_prediction: Callable[[], int], run_correction: Callable[[], int]
    ) -> tuple[Callable[[ArrayLike | None], bool], Callable[[ArrayLike | None], bool]]:
        # These run in real time: what they need are local names.
        facts = self.arrays["facts"]
        fill_input = _filler(self.arrays["u"], filter._input)
        fill_measurement = _filler(self.arrays["y"], filter._measurement)
        seen, periods = self.arrays["y"], filter.sample_periods
        slower = bool((periods > 1).any())

        def predict(u: ArrayLike | None = None) -> bool:
            fill_input(u)
            if run_prediction():
                return False
            self.step += 1
            return True

        def correct(y: ArrayLike | None) -> bool:
            fill_measurement(y)
            if slower:
                seen[self.step % periods != 0] = math.nan
            code = run_correction()
            if code == EMPTY:
                self.skipped += 1
                facts[:] = 0.0
                return True
            return not code

        return predict, correct

    def fit(self, filter: Filter) -> bool:
        """Whether they are still those of the filter, whatever its numbers are."""
        return self.key == code_key(filter)

    def load(self, filter: Filter) -> None:
        """Take over what the filter keeps, and its numbers."""
        values, arrays = vars(filter), self.arrays
        arrays["belief"][:] = np.concatenate([np.ravel(part) for part in values["_belief"]])
        arrays["input"][:] = values["_u"]
        arrays["parameters"][:] = filter.plant.parameters.flat(filter._parameters)
        arrays["q"][:], arrays["r"][:] = filter.process_noise.ravel(), filter.measurement_noise.ravel()
        arrays["counts"][:] = 0.0
        arrays["facts"][:] = -2.0 * values["log_likelihood"], 0.0
        self.step, self.skipped, self.repairs = values["_step"], 0, values["_repairs"]

    # What a filter keeps between two calls, by the names of its attributes --------------------------
    @property
    def _belief(self) -> Belief:
        return self.kind(*_parts(self.arrays["belief"].copy(), self.shapes))

    @property
    def _u(self) -> np.ndarray:
        return self.arrays["input"].copy()

    @property
    def _step(self) -> int:
        return self.step

    @property
    def _repairs(self) -> dict[str, int]:
        missing, singular = self.arrays["counts"].astype(int).tolist()
        more = {"skipped": self.skipped, "missing": missing, "singular": singular}
        return {name: count + more.get(name, 0) for name, count in self.repairs.items()}

    @property
    def log_likelihood(self) -> float:
        """Of the last measurement."""
        squares, used = self.arrays["facts"].tolist()
        return -0.5 * (squares + used * math.log(2.0 * math.pi))

    def mean(self) -> np.ndarray:
        """Estimate x̂, (n,)."""
        return self.arrays["belief"][: math.prod(self.shapes[0])].copy()


def code_key(filter: Filter) -> tuple[object, ...]:
    """Key of the compiled updates: equal for filters that differ in data alone."""
    return "updates", type(filter), filter.estimator_key, filter.plant.code_key


def compiled_updates(filter: Filter) -> CompiledUpdates | None:
    """The updates of a filter as machine code; None where there is none for its model."""
    try:
        return CompiledUpdates(filter)
    except Exception as reason:  # whatever keeps the model from being traced, NumPy evaluates it
        _LOGGER.info("predict and correct stay with NumPy: %s", " ".join(str(reason).split()))
        return None


def _filler(
    buffer: np.ndarray, checked: Callable[[ArrayLike | None], np.ndarray]
) -> Callable[[ArrayLike | None], None]:
    """Copier of a value to the buffer: of what already is such an array, or else of what is left by a check."""
    kind, shape, number = np.ndarray, buffer.shape, buffer.dtype
    memory: Any = memoryview(cast(Any, buffer))  # an array exports its memory, which its type does not say

    def fill_number(value: Any) -> None:  # what is no number is refused by the check
        if type(value) is kind and value.shape == shape and value.dtype == number:
            memory[0] = value.item()
        elif type(value) is float:
            memory[0] = value
        else:
            buffer[:] = checked(value)

    def fill(value: Any) -> None:
        fits = type(value) is kind and value.shape == shape and value.dtype == number
        buffer[:] = value if fits else checked(value)

    return fill_number if buffer.size == 1 else fill


# The programs --------------------------------------------------------------------------------------------
def _parts(vector: Elements | Block, shapes: list[tuple[int, ...]]) -> Iterator[Any]:
    first = 0
    for shape in shapes:
        yield vector[first : first + math.prod(shape)].reshape(shape)
        first += math.prod(shape)


class _Update:
    """A program that makes another belief of a belief, or changes nothing."""

    def __init__(self, filter: Filter) -> None:
        self.filter, self.run, self.buffers = filter, Composer(), list[Buffer]()
        plant, self.shapes = filter.plant, [np.shape(part) for part in filter.initial]
        self.vector = self.block("belief", (sum(map(math.prod, self.shapes)),), "state")
        self.belief = type(filter.initial)(*_parts(self.vector, self.shapes))
        self.parameters = self.block("parameters", (plant.parameters.size,))
        self.counts = self.block("counts", (2,), "state")
        self.copies: list[Copy] = []

    def block(self, name: str, shape: tuple[int, ...], role: Any = "in") -> Block:
        size = math.prod(shape)
        if size:
            self.buffers.append(Buffer(name, size, role))
        return Block(Slice(name, size=size) if size else None, shape)

    def check(self, block: Block, code: int = UNUSUAL) -> None:
        """End with the code where a number is not finite."""
        if block.size:
            self.run.body.append(Guard(block.place, code))

    def at_the_end(self, source: Block, target: Block) -> None:
        """Copy, once all is well."""
        if source.size:
            self.copies.append(Copy(source.place, target.place))

    def program(self, name: str, belief: Belief, missing: Block | None = None) -> Program:
        """With what a filter accepts as a belief, see `flexhinf.estimation.shell.Shell`."""
        run = self.run
        after = run.work((self.vector.size,))
        for part, place in zip(belief, _parts(after, self.shapes)):
            run.copy(part, place)
        self.check(after)
        counts = [self.counts] if missing is None else [self.counts, missing]
        if self.filter.form == "covariance":
            factor = run.cholesky(belief.covariance)
            self.check(factor)
            counts.append(run.call(_singular, factor, belief.covariance))
        if len(counts) > 1:
            self.at_the_end(run.call(_total, *counts), self.counts)
        self.at_the_end(after, self.vector)
        return Program(name, (*self.buffers, *run.buffers), (*run.body, *self.copies))


def as_arrays(*blocks: Block | Elements) -> tuple[Elements, ...]:
    """Blocks of a program as the text of a filter takes them: for arrays."""
    return cast(tuple[Elements, ...], blocks)


def _prediction(filter: Filter) -> Program:
    update, plant = _Update(filter), filter.plant
    u, q = update.block("u", (len(plant.inputs),)), update.block("q", (plant.n, plant.n))
    update.check(u)
    belief = filter.time_stages(update.run.as_run, update.belief, *as_arrays(u, update.parameters, q))
    update.at_the_end(u, update.block("input", u.shape, "state"))
    return update.program("filter_prediction", belief)


def _correction(filter: Filter) -> Program:
    update, plant = _Update(filter), filter.plant
    run, p = update.run, len(plant.outputs)
    u, y = update.block("input", (len(plant.inputs),)), update.block("y", (p,))
    noise, facts = update.block("r", (p, p)), update.block("facts", (2,), "out")
    finite, present, missing = run.call(_presence, y)
    update.check(finite)
    update.check(present, EMPTY)
    prior = update.belief
    belief, innovation, spread = filter.innovation_stages(
        run.as_run, prior, *as_arrays(y, u, update.parameters, noise)
    )
    factor = run.cholesky(cast(Block, spread))
    rejected = () if filter.gate is None else (prior.rejected, belief.rejected)
    found = run.call(_facts, innovation, factor, y, *rejected)
    update.check(found[2:])
    if filter.says_digits:
        update.check(run.call(_clear, belief.rcond))
    update.at_the_end(found[:2], facts)
    return update.program("filter_correction", belief, missing)


PROGRAMS: tuple[Callable[[Filter], Program], ...] = (_prediction, _correction)


def _total(*counts: Elements) -> Elements:
    return sum(counts[1:], counts[0])


def _singular(factor: Elements, covariance: Elements) -> Elements:
    """No missing elements, and the pivots that are zero where a variance is not."""
    pairs = zip(np.diag(factor), np.diag(covariance), strict=True)
    return np.array(
        [0.0, sum(where(pivot == 0.0, where(variance > 0.0, 1.0, 0.0), 0.0) for pivot, variance in pairs)]
    )


def _presence(y: Elements) -> tuple[Elements, Elements, Elements]:
    """Something that is not finite where an element is infinite; where all are missing; how many are, and a zero."""
    count = known(y).sum()
    finite = np.array([where(absolute(element) >= np.inf, np.nan, 0.0) for element in y])
    return finite, np.array([where(count > 0.0, 0.0, np.nan)]), np.array([len(y) - count, 0.0])


def _facts(
    innovation: Elements,
    factor: Elements,
    y: Elements,
    before: Elements | float = 0.0,
    after: Elements | float = 0.0,
) -> Elements:
    """Squared innovations over their covariance and the logarithm of its determinant; how many elements are used; and
    zero, or NaN where no noise explains the innovations."""
    white = solve_lower(factor, innovation)
    squares, used = white @ white, known(y).sum() - np.sum(after - before)
    absurd = where(squares > innovation_limit(len(y)), np.nan, 0.0)
    return np.array([squares + 2.0 * np.log(np.diag(factor)).sum(), used, absurd])


def _clear(rcond: Elements) -> Elements:
    """Zero, or NaN where a correction has lost digits."""
    return np.array([where(rcond[0] >= RCOND_LIMIT, 0.0, np.nan)])
