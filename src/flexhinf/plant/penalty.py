"""What the design wants small: z = (h(x), l(x) u) with lᵀl = R2, Eqs. (3) and (4)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput

__all__ = ["Penalty"]


@dataclass(frozen=True)
class Penalty:
    """Weights on the states and on the input.

    Parameters
    ----------
    states : mapping of str to float, sequence of float, or callable
        Weight of each state in h(x), as in the paper's (11): ``{"link_position": 60, "link_position_integral": 300}``,
        or one number per state (integrals last), or ``h(x, p)`` itself as NumPy code. x is the deviation from
        the operating point.
    effort : float or (m,) or (m, m) array
        R2 of Eq. (4): the penalty on the input is uᵀ R2 u. The paper has R2 = 10.

    Raises
    ------
    InvalidInput
        If R2 is not symmetric positive definite or a weight is not finite.
    """

    states: Mapping[str, float] | Sequence[float] | Callable[..., Any]
    effort: Any = 1.0

    @staticmethod
    def of(penalty: Any) -> Penalty:
        """A Penalty as it is; anything else as the weights of the states, with R2 = I."""
        return penalty if isinstance(penalty, Penalty) else Penalty(penalty)

    def r2(self, inputs: int) -> np.ndarray:
        """R2 as a symmetric positive definite matrix (m, m)."""
        effort = np.asarray(self.effort, dtype=float)
        matrix = effort if effort.ndim == 2 else np.diag(np.broadcast_to(effort, (inputs,)))
        if matrix.shape != (inputs, inputs):
            raise InvalidInput(
                "The effort penalty R2 has the wrong shape.",
                f"expected ({inputs}, {inputs}) for {inputs} inputs, got {matrix.shape}",
                "a number, one number per input, or a matrix",
            )
        if (
            not np.all(np.isfinite(matrix))
            or not np.allclose(matrix, matrix.T)
            or np.linalg.eigvalsh(matrix)[0] <= 0
        ):
            raise InvalidInput(
                "The effort penalty R2 is not symmetric positive definite.",
                f"expected positive eigenvalues (the input must cost something), got {matrix.tolist()}",
                "a positive number, for example effort=10",
            )
        return np.array(matrix)

    def evaluate(self, x: Any, names: Sequence[str], p: Any) -> Any:
        """h(x) on any element, shape (s,)."""
        if callable(self.states):
            return np.atleast_1d(np.asarray(self.states(x, p)))
        weights = self.weights(names)
        return np.array([weights[i] * x[i] for i in range(len(weights)) if weights[i] != 0.0])

    def weights(self, names: Sequence[str]) -> np.ndarray:
        """One weight per state, (n,); for a penalty given by numbers."""
        if isinstance(self.states, Mapping):
            unknown = [name for name in self.states if name not in names]
            if unknown:
                raise InvalidInput(
                    f"The penalty names a state that the problem does not have: {unknown[0]!r}.",
                    f"expected names out of {list(names)}",
                    "integrals of a tracking error are called NAME_integral",
                )
            weights = np.array([float(self.states.get(name, 0.0)) for name in names])
        else:
            weights = np.asarray(self.states, dtype=float)
        if weights.shape != (len(names),) or not np.all(np.isfinite(weights)):
            raise InvalidInput(
                "The penalty does not fit the states.",
                f"expected {len(names)} finite weights for {list(names)}, got {np.array2string(weights)}",
                "one weight per state, zero for what may be large",
            )
        return weights
