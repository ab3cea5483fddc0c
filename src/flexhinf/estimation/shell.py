"""The shell of a filter: an object that keeps its belief, with `predict` and `correct`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.estimation.diagnosis import CLOSE, CURES, Diagnosis, lost_digits
from flexhinf.scalars import cholesky, solve_lower
from flexhinf.validation import checked_array, real_array, value_text

#: Entries of `RecursiveFilter.diagnosis` that are kept.
LONGEST_DIAGNOSIS = 1000


class Shell:
    """What keeps the belief of a `flexhinf.estimation.filter.RecursiveFilter`."""

    if TYPE_CHECKING:
        plant: Any
        form: str
        gate: float | None
        initial: Any
        process_noise: np.ndarray
        measurement_noise: np.ndarray
        measured: Any
        time_update: Any
        innovate: Any
        _parameters: Any

    @property
    def mean(self) -> np.ndarray:
        """Estimate x̂, (n,)."""
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
        """
        return {**self._repairs, "rejected": int(self.rejected.sum())}

    def predict(self, u: Any) -> None:
        """Time update with the input u (m,) held over the period.

        Raises
        ------
        InvalidInput
            If u does not fit the plant.
        """
        self._u = self._vector(u, self.plant.inputs, "input")
        with np.errstate(all="ignore"):  # checked below
            belief = self.time_update(self._belief, self._u, self._parameters, self.process_noise)
        self._accept(belief)
        self._step += 1

    def correct(self, y: Any) -> None:
        """Measurement update with y (p,); sets `log_likelihood` of this measurement, of the elements that are used.

        NaN, None and masked elements are missing ones. Where all are, nothing changes.

        Raises
        ------
        InvalidInput
            If y does not fit the plant.
        """
        y = self._measurement(y)
        flags, prior = np.isfinite(y), self._belief
        there = np.count_nonzero(flags)
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
            if self.form == "square_root":
                slope = self.measured(prior.mean, self._u, self.plant.parameters.flat(self._parameters))[1]
                noise = self.measurement_noise[np.ix_(flags, flags)]
                if not lost_digits(prior.root, slope[flags], noise, innovation[flags]) <= CLOSE:
                    self._record("digits")
            factor = cholesky(np.asarray(spread, dtype=float))
            white = solve_lower(factor, np.asarray(innovation, dtype=float))
            constant = there * np.log(2.0 * np.pi)
            likelihood = -0.5 * (white @ white + constant) - np.log(np.diag(factor)).sum()
        self.log_likelihood = float(likelihood)

    def reset(self) -> None:
        """Back to the belief before the first measurement."""
        self._belief: Any = self.initial
        self._u = np.zeros(len(self.plant.inputs))
        self._repairs: dict[str, int] = dict.fromkeys(("skipped", "missing", "rejected", "singular"), 0)
        self.log_likelihood = float("nan")
        self._step, self._diagnosis = 0, ()

    @property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """What was wrong since `reset`, up to the first 1000 entries; empty while all is well."""
        return self._diagnosis

    def _record(self, kind: str) -> None:
        if len(self._diagnosis) < LONGEST_DIAGNOSIS:
            self._diagnosis = (*self._diagnosis, Diagnosis(kind, self._step, CURES[kind]))

    def _vector(self, value: Any, names: Sequence[str], what: str, hint: str = "") -> np.ndarray:
        return checked_array(
            f"The {what} given to the estimator does not fit its plant.",
            value,
            (len(names),),
            f"{len(names)} finite numbers for {list(names)}",
            f"one number per name {hint}".rstrip(),
        )

    def _measurement(self, y: Any) -> np.ndarray:
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

    def _accept(self, belief: Any) -> bool:
        """Take over a belief that is finite and whose covariance has a Cholesky factor: every update begins with it.

        Any other leaves the last one, and an entry in `diagnosis`; the first of them is a warning, too.
        """
        finite = all(np.all(np.isfinite(np.asarray(part, dtype=float))) for part in belief)
        p = np.zeros((0, 0)) if self.form == "square_root" else np.asarray(belief.covariance, dtype=float)
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
