"""What law and filter do at a sample, by the states of a pair's loop, in ball arithmetic."""

from __future__ import annotations

import numpy as np
from flint import arb, arb_series

from flexhinf.certify.checker.motor_errors import sampled_names
from flexhinf.certify.checker.pair_claim import PairClaim
from flexhinf.certify.checker.taylor_matrix import TaylorMatrix, taylor_row


class LawAtSample:
    """Filter, gains and integral of a pair with λ = centre + half·u."""

    def __init__(self, claim: PairClaim, centre: arb, half: arb) -> None:
        self._claim, self._box = claim, (centre, half)
        self._h, n, predicted = arb(claim.period), claim.states, 4 * claim.with_prediction
        self.unit = TaylorMatrix.of(np.eye(n).tolist())
        self.state = self.unit.rows(0, 4)
        self.predicted = self.unit.rows(4, 8) if predicted else self.state
        # (z, z′, w, w′) in seconds, of (z, z′, s, s′) in periods.
        self._plain = TaylorMatrix.of(
            [[1, 0, 0, 0], [0, 1 / self._h, 0, 0], [1, 0, 1, 0], [0, 1 / self._h, 0, 1 / self._h]]
        )
        self.estimate = self._corrected()
        exact = claim.seen is None or [1.0, 0.0, 0.0, 0.0] in claim.seen.tolist()
        self.position = (self.state if exact else self.estimate).rows(0, 1)
        self.total = self.unit.rows(4 + predicted, 5 + predicted)
        last = self.unit.rows(5 + predicted, 6 + predicted)
        self.integral = self.total + (last + self.position).times(arb(0.5))
        self.added = [[self.unit.rows(n - claim.added, n)]] if claim.added else []

        def poles(link: arb_series) -> list[arb_series]:
            return [arb(p) / (link + arb(p)) for p in claim.poles.tolist()] + [arb_series([1])]

        self.gains = taylor_row(poles, centre, half) @ TaylorMatrix.of(claim.coefficients.T.tolist())

    def _corrected(self) -> TaylorMatrix:
        """The filter's estimate; without one the state."""
        claim, h = self._claim, self._h
        if claim.seen is None or claim.table is None or claim.filter_range is None:
            return self.state
        back = TaylorMatrix.of([[1, 0, 0, 0], [0, h, 0, 0], [-1, 0, 1, 0], [0, -h, 0, h]])
        table, (low, high) = claim.table, map(arb, claim.filter_range)

        def cosines(link: arb_series) -> list[arb_series]:
            angle = ((2 * link.log() - (low + high)) / (high - low)).acos()
            return [(k * angle).cos() for k in range(len(table))]

        series = taylor_row(cosines, *self._box) @ TaylorMatrix.of(table.tolist())
        columns = len(claim.seen)
        gain = TaylorMatrix.stacked([[series.columns(i * columns, (i + 1) * columns)] for i in range(4)])
        seen = TaylorMatrix.of(claim.seen.tolist())
        return self.predicted + back @ gain @ seen @ self._plain @ (self.state - self.predicted)

    def force(self, ahead: TaylorMatrix, integral: TaylorMatrix) -> TaylorMatrix:
        """The input for a state and an integral that the law knows."""
        return -(
            self.gains.columns(0, 4) @ self._plain @ ahead
            + self.gains.columns(4, 5).times(self._h) @ integral
        )


def sampled(
    claim: PairClaim, centre: arb, half: arb, flow: TaylorMatrix
) -> tuple[TaylorMatrix, TaylorMatrix]:
    """(z, z′, s, s′), the acting inputs and what errors add, and the memory after a period, by the states of the
    loop."""
    law, observed = LawAtSample(claim, centre, half), claim.seen is not None
    ahead, memory, n = law.estimate, 6 + 4 * observed, claim.states
    first = memory + (claim.delay > 0.0)
    waiting = [law.unit.rows(k, k + 1) for k in range(first, n - claim.added)]
    for one in waiting:
        ahead = flow @ TaylorMatrix.stacked([[ahead], [one]])
    queue = [*waiting, law.force(ahead, law.integral)]
    after = [flow @ TaylorMatrix.stacked([[law.estimate], [queue[0]]])] if observed else []
    after = [[part] for part in (*after, law.integral, law.position, *queue[: first - memory], *queue[1:])]
    before = [[law.unit.rows(memory, first)]] if claim.delay else []
    return TaylorMatrix.stacked([[law.state], *before, [queue[0]], *law.added]), TaylorMatrix.stacked(after)


def sampled_with_model(
    claim: PairClaim, centre: arb, half: arb
) -> tuple[TaylorMatrix, TaylorMatrix | None, TaylorMatrix]:
    """Where the model moves beside a pair, the states of the flow by those of the loop, and by n₀ and p₀ of unlike
    motors; and the integral, the last position and an input that waits after a period.

    The law acts on the estimate, or with a latency on the prediction, and by this state it makes motors alike.
    """
    law, names = LawAtSample(claim, centre, half), sampled_names(claim.motors) if claim.motors else []
    known, integral = (law.predicted, law.total) if claim.latency else (law.estimate, law.integral)
    force, speed, first = law.force(known, integral), known.rows(1, 2) + known.rows(3, 4), 4
    nothing = TaylorMatrix.of([[0] * claim.states])
    begun, after = [law.state, force], [law.integral, law.position]
    if claim.delay:
        place, first = 6 + 4 * claim.with_prediction, 5
        begun.insert(1, law.unit.rows(place, place + 1))
        after.append(force)
    begun += [known.rows(2, 3), nothing, speed, nothing][: len(names)]
    acting = TaylorMatrix.stacked([*([part] for part in (*begun, law.estimate)), *law.added])
    memory = TaylorMatrix.stacked([[part] for part in after])
    if not names:
        return acting, None, memory
    size = first + 1 + len(names) + 4 + claim.added
    # n₀, p₀, and what the law leaves of them, as an input.
    places, entry = np.zeros((size, len(names) // 2), dtype=int), np.zeros((size, 1), dtype=int)
    entry[first], weights = 1, [arb(-1), -1 / (arb(claim.motor) * arb(claim.period) ** 2)]
    for k in range(len(names) // 2):
        places[first + 2 + 2 * k, k] = 1
    left = TaylorMatrix.of([[1]]) - law.gains.columns(5, 6)
    row = left @ TaylorMatrix.of([weights[: len(names) // 2]])
    return acting, TaylorMatrix.of(places.tolist()) + TaylorMatrix.of(entry.tolist()) @ row, memory
