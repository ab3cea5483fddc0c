"""The flow of a pair over a period in which the new input acts only after a time θ, in ball arithmetic.

Until θ the input of the period before acts. Both are constant, so that the flow is the product of two exponentials.
"""

from __future__ import annotations

import numpy as np
from flint import arb

from flexhinf.certify.checker.taylor_matrix import TaylorMatrix

#: The places of the input of the period before and of the new one, after (z, z′, s, s′).
BEFORE, NEW = 4, 5


def late_flow(hamiltonian: TaylorMatrix, rate: arb, centre: arb, half: arb) -> TaylorMatrix:
    """Of (z, z′, s, s′), both inputs, what errors add, and costates, from the matrix of a flow with one input, with
    θ = centre + half·v; all signals grow with a rate, per period."""
    size = hamiltonian.constant.nrows() // 2 + 1
    # exp(θH) and exp((1 − θ)H): the parts of both with v are the same but for its sign
    apart = hamiltonian.along(arb(0), half).exponential()
    first = hamiltonian.times(centre).exponential() @ apart
    last = hamiltonian.times(1 - centre).exponential() @ apart.turned()
    waits = np.zeros((2 * size, 2 * size), dtype=int)
    waits[NEW, NEW], waits[size + NEW, size + NEW] = 1, -1
    growth = TaylorMatrix.of(waits.tolist()).times(rate).along(centre, half).exponential()
    return _beside(last, BEFORE, size) @ growth @ _beside(first, NEW, size)


def with_input_before(shift: TaylorMatrix) -> TaylorMatrix:
    """A form of (z, z′, s, s′), the new input and what errors add, as one that has the input of the period before
    too."""
    size = shift.constant.nrows() + 1
    into = _into([k for k in range(size) if k != BEFORE], size)
    return into @ shift @ into.transpose()


def _beside(flow: TaylorMatrix, other: int, size: int) -> TaylorMatrix:
    """A flow that does not see one of the inputs, which stays."""
    acts = [k for k in range(size) if k != other]
    into = _into([*acts, *(size + k for k in acts)], 2 * size)
    kept = np.zeros((2 * size, 2 * size), dtype=int)
    kept[other, other] = kept[size + other, size + other] = 1
    return into @ flow @ into.transpose() + TaylorMatrix.of(kept.tolist())


def _into(places: list[int], size: int) -> TaylorMatrix:
    """Of coordinates, those at some places among more."""
    into = np.zeros((size, len(places)), dtype=int)
    into[places, range(len(places))] = 1
    return TaylorMatrix.of(into.tolist())
