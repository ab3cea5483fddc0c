"""Penalty of a design: z = (h(x), l(x) u) with lᵀl = R2, Eqs. (3) and (4)."""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import copy
import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.notebook import StatedRepr
from flexhinf.plant.code import has_a_name
from flexhinf.plant.parameters import Parameters
from flexhinf.plant.polynomial_plant import checked_r2
from flexhinf.validation import checked_array, checked_names, real_array, value_text

#: Weights of states by name or in order, a matrix, or a function h(x, p).
StateWeights: TypeAlias = Mapping[str, float] | Sequence[float] | Callable[..., ArrayLike] | np.ndarray


@dataclass(frozen=True, repr=False)
class Penalty(StatedRepr):
    """Weights on the states and on the input.

    Parameters
    ----------
    states : mapping of str to float, sequence of float, or callable
        Weight of each state in h(x), as in the paper's (11):
        ``{"link_position": 60, "link_position_integral": 300}``, or one number per state (integrals last), or
        ``h(x, p)`` itself as NumPy code with h(0) = 0, or a matrix C (s, n) of h = C x. x is the deviation from the
        operating point.
    effort : float or (m,) or (m, m) array
        R2 of Eq. (4): the penalty on the input is uᵀ R2 u. The paper has R2 = 10.

    Raises InvalidInput: if R2 is not symmetric positive definite, or a weight is negative or not finite.

    Examples
    --------
    >>> import flexhinf as fh
    >>> penalty = fh.Penalty({"link_position": 60.0, "link_position_integral": 300.0}, effort=10.0)
    >>> fh.paper_arm().problem(penalty).state_names[-1]
    'link_position_integral'
    """

    states: StateWeights
    effort: ArrayLike = 1.0

    def __post_init__(self) -> None:
        named: Mapping[Any, Any] = {}
        if isinstance(self.states, Mapping):
            named = dict(cast(Mapping[str, Any], self.states))
            object.__setattr__(self, "states", named)
            checked_names("The weighted states", named)
        elif not callable(self.states):
            rows = real_array(self.states)
            if rows.ndim not in (1, 2):
                raise InvalidInput(
                    "The penalty is not made of weights.",
                    f"expected weights by name, one per state, a matrix or a function, got {value_text(self.states)}",
                    "{'link_position': 60.0}",
                )
            named = {k + 1: weight for k, weight in enumerate(self.states)} if rows.ndim == 1 else {}
            if not isinstance(self.states, (list, tuple, np.ndarray)):
                object.__setattr__(self, "states", rows)
        for name, weight in named.items():
            values = np.atleast_1d(real_array(weight))
            if np.any(values < 0.0):  # what is no number is refused where the names are known
                raise InvalidInput(
                    f"The weight {f'number {name}' if isinstance(name, int) else f'of {name!r}'} is negative.",
                    f"expected weights >= 0 (the sign would not act: h(x) is squared), got {value_text(weight)}",
                    f"{np.abs(values).max(initial=0.0):g}, or leave the weight out",
                )
        effort = real_array(self.effort)
        if not np.all(np.isfinite(effort)) or effort.ndim > 2:
            raise InvalidInput(
                "The effort penalty R2 is not made of finite numbers.",
                f"expected a number, one number per input, or a matrix, got {value_text(self.effort)}",
                "a positive number, for example effort=10",
            )

    def __copy__(self) -> Penalty:
        return Penalty(self.states, self.effort)

    def __deepcopy__(self, memo: dict[int, object]) -> Penalty:
        return Penalty(copy.deepcopy(self.states, memo), copy.deepcopy(self.effort, memo))

    def __getstate__(self) -> dict[str, object]:
        if callable(self.states) and not has_a_name(self.states):
            raise InvalidInput(
                "A penalty of code without a name cannot be pickled.",
                f"expected weights, a matrix, or a function of a module, got {value_text(self.states, 80)}",
                "def h(x, p): … at the top of a module; or make the problem anew where it is needed",
            )
        return {"states": self.states, "effort": self.effort}

    @staticmethod
    def of(penalty: Penalty | StateWeights) -> Penalty:
        """A Penalty as it is; anything else as the weights of the states, with R2 = I."""
        return penalty if isinstance(penalty, Penalty) else Penalty(penalty)

    def expanded(self, groups: Mapping[str, Sequence[str]]) -> Penalty:
        """The same penalty with the name of each group replaced by its signals; single names win over groups.

        ``NAME_integral`` of a group stands for the integrals of all of its states. A weight of a group is one number,
        or one for each.
        """
        if not isinstance(self.states, Mapping):
            return self
        weights, singles = dict[str, Any](), dict[str, Any]()
        weight: Any
        for name, weight in cast(Mapping[str, Any], self.states).items():
            stem = name.removesuffix("_integral")
            members = groups.get(name) or [f"{m}_integral" for m in groups.get(stem, ())]
            if members and np.ndim(weight) and np.shape(weight) != (len(members),):
                raise InvalidInput(
                    f"The weights of {name!r} do not fit its signals.",
                    f"expected one number, or one for each of {list(members)}, got {value_text(weight)}",
                    "a number for all of them",
                )
            weights.update(zip(members, weight if np.ndim(weight) else [weight] * len(members)))
            if not members and stem not in groups:
                singles[name] = weight
        return replace(self, states={**weights, **singles})

    def r2(self, inputs: int) -> np.ndarray:
        """R2 as a symmetric positive definite matrix (m, m)."""
        effort = np.asarray(self.effort, dtype=float)
        rows = np.full(inputs, effort) if effort.ndim == 0 else effort
        matrix = np.diag(rows) if rows.ndim == 1 else rows
        refuse_if(
            matrix.shape != (inputs, inputs),
            "The effort penalty R2 has the wrong shape.",
            f"expected ({inputs}, {inputs}) for {inputs} inputs, got {matrix.shape}",
            "a number, one number per input, or a matrix",
        )
        return checked_r2(matrix, 1e-9, 1e-12)

    def evaluate(self, x: Elements, names: Sequence[str], p: Parameters) -> Elements:
        """h(x) on any element, shape (s,)."""
        if callable(self.states):
            return np.atleast_1d(np.asarray(self.states(x, p)))
        rows = self.matrix
        if rows is not None:
            if rows.shape[1] != len(names) or not len(rows) or not np.all(np.isfinite(rows)):
                raise InvalidInput(
                    "The penalty does not fit the states.",
                    f"expected finite numbers with a column for each of {list(names)}, got shape {rows.shape}",
                    "one row per penalised signal",
                )
            return rows @ np.asarray(x)
        weights = self.weights(names)
        return np.array([weights[i] * x[i] for i in range(len(weights)) if weights[i] != 0.0])

    @property
    def matrix(self) -> np.ndarray | None:
        """C (s, n) for a penalty that is a matrix, else None."""
        other = callable(self.states) or isinstance(self.states, Mapping) or np.ndim(self.states) != 2
        return None if other else real_array(self.states)

    def weights(self, names: Sequence[str]) -> np.ndarray:
        """One weight per state, (n,); for a penalty given by one number for each."""
        listed: Any = self.states
        if isinstance(self.states, Mapping):
            stated = cast(Mapping[str, float], self.states)
            check_weighted(stated, names)
            listed = [stated.get(name, 0.0) for name in names]
        return checked_array(
            "The penalty does not fit the states.",
            listed,
            (len(names),),
            f"{len(names)} finite weights for {list(names)}",
            "one weight per state, zero for what may be large",
        )


def check_weighted(weighted: Iterable[str], known: Sequence[str]) -> None:
    """Refuse a weight of something that is not known, with the known name that is most like it."""
    for name in (name for name in weighted if name not in known):
        close = max(known, key=lambda other: difflib.SequenceMatcher(None, name, other).ratio())
        raise InvalidInput(
            f"The penalty names a state that the problem does not have: {name!r}.",
            f"expected names out of {list(known)}",
            f"{close!r}; integrals of a tracking error are called NAME_integral",
        )
