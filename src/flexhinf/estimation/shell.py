"""The shell of a filter: an object that keeps its belief, with `predict` and `correct`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput
from flexhinf.estimation.diagnosis import CURES, EPS, Diagnosis, innovation_limit, recorded
from flexhinf.estimation.interface import Filter, Form
from flexhinf.plant import Parameters, Plant, rcond_limit
from flexhinf.plant.protocols import Belief
from flexhinf.scalars import cholesky, solve_lower
from flexhinf.validation import checked_array, real_array, value_text

if TYPE_CHECKING:
    from flexhinf.estimation.compiled import CompiledUpdates

#: Reciprocal condition of a correction below which digits are lost.
RCOND_LIMIT = rcond_limit(EPS)

#: Entries of `RecursiveFilter.diagnosis` that are kept.
LONGEST_DIAGNOSIS = 1000

#: Calls that NumPy makes before both updates are compiled: that takes as long as some hundred of the paper's arm.
NUMPY_CALLS = 100

#: What a filter keeps between two calls: in its attributes, or in those of `CompiledUpdates`.
KEPT = ("_belief", "_u", "_step", "_repairs", "log_likelihood")


class Shell:
    """What keeps the belief of a `flexhinf.estimation.filter.RecursiveFilter`.

    `predict` and `correct` are NumPy's first, then machine code of the same text, equal to rounding (see
    `flexhinf.estimation.compiled`). A model that cannot be compiled stays with NumPy, and so does a subclass that
    writes `time_update` or `innovate`.
    """

    _only_numpy = False
    _compiled: CompiledUpdates | None = None  # where it keeps the belief
    _ready: CompiledUpdates | None = None
    _calls = 0

    if TYPE_CHECKING:
        plant: Plant
        form: Form
        gate: float | None
        initial: Belief
        _clipped: tuple[Diagnosis, ...]
        _exact: bool
        process_noise: np.ndarray
        measurement_noise: np.ndarray
        sample_periods: np.ndarray
        time_update: Callable[..., Belief]
        innovate: Callable[..., tuple[Belief, Elements, Elements]]
        _parameters: Parameters

    @property
    def mean(self) -> np.ndarray:
        """Estimate x̂, (n,)."""
        if self._compiled is not None:
            return self._compiled.mean()
        return np.array(self._belief.mean, dtype=float)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance P, (n, n)."""
        return np.array(self._belief.covariance, dtype=float)

    @property
    def rejected(self) -> np.ndarray:
        """How often each element of a measurement was rejected by the gate since the start, (p,) of int."""
        counts = np.zeros(len(self.plant.outputs)) if self.gate is None else self._belief.rejected
        return np.array(counts, dtype=int)

    @property
    def repairs(self) -> dict[str, int]:
        """What `correct` and `predict` went on in spite of since the start, and how often.

        "skipped": samples where nothing was measured. "missing", "rejected": elements of other samples. "singular":
        pivots of covariances that were zero to rounding, and taken for zero; rows of deviations need no such thing.
        "covariance": covariances that the filter was given and that were clipped, which `reset` leaves.
        """
        return {**self._repairs, "rejected": int(self.rejected.sum())}

    @property
    def says_digits(self) -> bool:
        """Whether digits that a correction loses are an entry of `diagnosis`."""
        return self.form == "square_root" or self._exact

    def predict(self, u: ArrayLike | None = None) -> None:
        """Time update with the input u (m,) held over the period; a plant without inputs needs none.

        Raises
        ------
        InvalidInput
            If u does not fit the plant.
        """
        compiled = self._compiled or self._prepared()
        if compiled is not None and compiled.predict(u):
            return
        self._settle()
        self._u = self._input(u)
        with np.errstate(all="ignore"):  # checked below
            belief = self.time_update(self._belief, self._u, self._parameters, self.process_noise)
        self._accept(belief)
        self._step += 1

    def correct(self, y: ArrayLike | None) -> None:
        """Measurement update with y (p,); sets `log_likelihood` of this measurement, of the elements that are used.

        NaN, None and masked elements are missing ones. Where all are, nothing changes.

        Raises
        ------
        InvalidInput
            If y does not fit the plant.
        """
        compiled = self._compiled or self._prepared()
        if compiled is not None and compiled.correct(y):
            return
        self._settle()
        y = self.new_values(self._measurement(y), self._step)
        there = np.count_nonzero(np.isfinite(y))
        if not there:
            self.log_likelihood, self._repairs = 0.0, _counted(self._repairs, skipped=1)
            return
        with np.errstate(all="ignore"):  # checked below
            belief, innovation, spread = self.innovate(
                self._belief, y, self._u, self._parameters, self.measurement_noise
            )
            before = self.rejected.sum()
            if not self._accept(belief):
                self.log_likelihood = float("nan")
                return
            self._repairs = _counted(self._repairs, missing=int(len(y) - there))
            there -= self.rejected.sum() - before
            if self.says_digits and not belief.rcond[0] >= RCOND_LIMIT:
                self._record("digits")
            factor = cholesky(np.asarray(spread, dtype=float))
            white = solve_lower(factor, np.asarray(innovation, dtype=float))
            constant = there * np.log(2.0 * np.pi)
            squares = white @ white
            likelihood = -0.5 * (squares + constant) - np.log(np.diag(factor)).sum()
            if squares > innovation_limit(len(y)):
                self._record("innovations")
        self.log_likelihood = float(likelihood)

    def new_values(self, y: np.ndarray, steps: int | np.ndarray) -> np.ndarray:
        """Measurements (p,) at a sample, or (N, p) at samples (N,), with NaN where a sensor with a period has no new
        one."""
        if (self.sample_periods == 1).all():
            return y
        return np.where(np.asarray(steps)[..., None] % self.sample_periods == 0, y, np.nan)

    # Machine code -----------------------------------------------------------------------------------
    def _prepared(self) -> CompiledUpdates | None:
        """The compiled updates with what the filter keeps, from its `NUMPY_CALLS`th call on."""
        if self._calls < NUMPY_CALLS or self._only_numpy:
            vars(self)["_calls"] = self._calls + 1
            return None
        from flexhinf.estimation.compiled import compiled_updates

        ready, filter = self._ready, cast(Filter, self)
        if ready is None or not ready.fit(filter):
            ready = compiled_updates(filter)
        vars(self).update(_ready=ready, _compiled=ready, _only_numpy=ready is None)
        if ready is not None:
            ready.load(filter)
            for name in KEPT:
                del vars(self)[name]
        return ready

    def _settle(self) -> None:
        """Take back what the compiled updates keep."""
        if self._compiled is not None:
            vars(self).update({name: getattr(self._compiled, name) for name in KEPT}, _compiled=None)

    def __getattr__(self, name: str) -> Any:
        if name in KEPT and (compiled := vars(self).get("_compiled")) is not None:
            return getattr(compiled, name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __setattr__(self, name: str, value: object) -> None:
        self._settle()  # its arrays have the numbers of before
        super().__setattr__(name, value)

    def __getstate__(self) -> dict[str, object]:
        state: dict[str, object] = super().__getstate__()  # pyright: ignore[reportAssignmentType, reportAttributeAccessIssue]
        state |= {name: getattr(self, name) for name in KEPT}
        return {name: value for name, value in state.items() if name not in ("_compiled", "_ready")}

    def reset(self) -> None:
        """Back to the belief before the first measurement."""
        self._belief: Belief = self.initial
        self._u = np.zeros(len(self.plant.inputs))
        counts = dict.fromkeys(("skipped", "missing", "rejected", "singular"), 0)
        self._repairs: dict[str, int] = {**counts, "covariance": len(self._clipped)}
        self.log_likelihood = float("nan")
        self._step, self._diagnosis = 0, self._clipped

    @property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """What made an estimate doubtful since `reset`, samples in a row as one, up to the first 1000 entries.

        It is about single samples: lost digits, innovations beyond all noise. `flexhinf.consistency` judges the model.
        """
        return self._diagnosis

    def _record(self, kind: str) -> None:
        self._diagnosis = recorded(self._diagnosis, kind, self._step, LONGEST_DIAGNOSIS)

    def _vector(self, value: ArrayLike | None, names: Sequence[str], what: str, hint: str = "") -> np.ndarray:
        return checked_array(
            f"The {what} given to the estimator does not fit its plant.",
            value,
            (len(names),),
            f"{len(names)} finite numbers for {list(names)}",
            f"one number per name {hint}".rstrip(),
        )

    def _input(self, u: ArrayLike | None) -> np.ndarray:
        names = self.plant.inputs
        hint = "" if names else "(there is none: predict())"
        return self._vector(() if u is None and not names else u, names, "input", hint)

    def _measurement(self, y: ArrayLike | None) -> np.ndarray:
        names, array = self.plant.outputs, np.full(len(self.plant.outputs), np.nan)
        with suppress(ValueError):
            array = array if y is None else real_array(y, strict=True)
            array = array[None] if array.ndim == 0 and len(names) == 1 else array
            if array.shape == (len(names),) and not np.isinf(array).any():
                return array
        raise InvalidInput(
            "The measurement given to the estimator does not fit its plant.",
            f"expected {len(names)} numbers for {list(names)}, finite or NaN, got {value_text(y)}",
            "one number per name, NaN for an element that is missing",
        )

    def _accept(self, belief: Belief) -> bool:
        """Take over a belief that is finite and whose covariance has a Cholesky factor: every update begins with it.

        Any other leaves the last one, and an entry in `diagnosis`; the first of them is a warning, too.
        """
        finite = all(np.all(np.isfinite(np.asarray(part, dtype=float))) for part in belief)
        p = np.zeros((0, 0)) if self.form == "square_root" else np.asarray(belief.covariance, dtype=float)
        with np.errstate(all="ignore"):  # checked below
            pivots = np.diag(cholesky(p))
        if finite and np.all(np.isfinite(pivots)):
            self._belief = belief
            singular = int(np.count_nonzero((pivots == 0.0) & (np.diag(p) > 0.0)))
            self._repairs = _counted(self._repairs, singular=singular)
            return True
        kind = "indefinite" if finite else "not finite"
        if kind not in {entry.kind for entry in self._diagnosis}:
            about = f"Sample {self._step} made the estimate {kind}, so it was left out: {CURES[kind]}."
            warnings.warn(about, stacklevel=3)
        self._record(kind)
        return False


def _counted(counts: dict[str, int], **more: int) -> dict[str, int]:
    """Counts and more of them; another dictionary, as copies of a filter share the first one."""
    return {name: count + more.get(name, 0) for name, count in counts.items()}
