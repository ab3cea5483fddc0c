"""The checker: it proves a certificate again from its data alone, independently of the search that found it.

`verify` returns `proved` only where the theorem of docs/theorem.md holds (its parts 1. to 8. have the numbers that
are used here): for every value of the parameters in the stated box (constant in time), for exact state feedback
u = k(x) in continuous time without limits, S the component of {x: V(x) ≤ c} that contains 0, with the exact elementary
functions and z = (h(x), R2^½ u).

**How, and what to read.** Read these files in this order; they decide, and fit on a few screens:

1. `residual`: r = V_x (f + g2 k) + ½hᵀh + ½kᵀR2k + |V_x g1|²/(2γ²) + αV in exact rationals.
2. There too: where r is a quadratic form for each value of the functions' quotients, definite matrices end the proof.
3. `bounds`: elementary functions become Taylor polynomials with remainders from ball arithmetic; V, its growth along
   rays, and r on cells, with an a-priori bound of all rounding.
4. `subdivision`: cells follow each other along rays from 0 until V exceeds the level.
5. This file: the other requirements (R2 ≻ 0, an invertible T, numbers within the doubles).

`guidance` chooses the next cells and refuses claims; it cannot prove. `second_route` proves a random sample of cells
again in rationals and balls, without 3. If it proves every cell, only 1., 2., 4., 5. and `second_route` need to be
read. `statements` proves 6., 7. and 8. of the theorem, where they are claimed.
docs/theorem.md has the proof, of every inequality that is relied on here, and counts the lines.

Checker and search share only the form of a claim (`claim`). Nothing here imports the search, and the search uses no
arithmetic from here. It calls the checker for its starts and its observer, so that it states only proved ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import Any

import numpy as np
from flint import ctx

from flexhinf.certify.checker.bounds import BITS, Face, Proof
from flexhinf.certify.checker.guidance import refute_at_corners
from flexhinf.certify.checker.residual import (
    ExactResidual,
    Refusal,
    check_reach,
    corner_text,
    look_at_corners,
    matrix_of,
    positive_definite,
    require,
)
from flexhinf.certify.checker.second_route import CellSample, ConfirmedCell, EveryCell, confirm
from flexhinf.certify.checker.statements import check_observer, check_start, proved_peaks
from flexhinf.certify.checker.subdivision import Verification, subdivide_face
from flexhinf.certify.claim import Claim

_MOST_KINDS, _MOST_UNCERTAIN = 64, 12  # of products; of parameters, whose corners are all looked at
_MIN_LEVEL = 1e-100
_MIN_REACH, _MAX_REACH = 1e-10, 1e10  # between these no power of ρ leaves the normal doubles
_MOST_CELLS = 10**8  # of all faces together
_MOST_AFTER_CORNERS = 120_000  # where r is a quadratic form and a corner of it fails
_FARTHEST = 1e3  # |ℓᵀx| of a function: its quotient has nodes up to there


@ctx.workprec(BITS)
def verify(
    claim: Claim,
    *,
    threads: int = 2,
    sample: int | None = 10,
    seed: int = 0,
    by_cells: bool = False,
    tick: Callable[[int], None] = lambda cells: None,
) -> Verification:
    """Prove a claim, or return the reason why not; `tick` is called with the number of cells that were just checked.

    `sample` cells of each face are proved a second time, or every cell (None). With `by_cells` cells are checked even
    if a quadratic form decides.
    """
    began, corner = time.process_time(), ""

    def ended(proved: bool, reason: str = "", **fields: Any) -> Verification:
        return Verification(proved, reason, **fields, cpu_s=time.process_time() - began)

    try:
        _check_sizes(claim)
        _check_matrices(claim)
        starts = sum(check_start(claim, start) for start in claim.starts)
        exact, peaks = ExactResidual(claim), proved_peaks(claim)
        if claim.observer is not None:
            check_observer(claim, claim.observer, exact.gradient_law)
        corners, failed = (0, []) if by_cells else look_at_corners(claim, exact)
        if failed:
            refute_at_corners(claim, exact, failed)
            corner = corner_text(claim, failed[0])
        elif corners:
            return ended(True, corners=corners, starts=starts, gradient_law=exact.gradient_law, peaks=peaks)
        check_reach(claim, exact)
        proof = Proof(claim)
        stopped, looked, most = Event(), 0, _MOST_AFTER_CORNERS if failed else _MOST_CELLS

        def watch(cells: int) -> None:
            nonlocal looked
            looked += cells
            require(not stopped.is_set(), "interrupted")
            why = f"{corner}, and cells do not decide: " * bool(corner)
            require(looked <= most, f"{why}undecided after {most:,} cells")
            tick(cells)

        chosen = [
            EveryCell(proof, face, watch) if sample is None else CellSample(face, sample, seed)
            for face in proof.faces
        ]
        with ThreadPoolExecutor(threads) as pool:
            try:  # threads begin while others are still submitted
                jobs = [pool.submit(_face, proof, part, watch) for part in chosen]
                results = [job.result() for job in jobs]
            except BaseException:  # the other threads end at their next cells, not at the end of their faces
                stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        again = _prove_again(proof, [cell for part in chosen for cell in part.cells], seed)
    except OverflowError:
        return ended(False, "numbers beyond the doubles appear: another unit, or another T.")
    except Refusal as refusal:
        reason = _reason(claim, refusal)
        if corner not in reason:  # cells refused, and say where
            reason += f" A{corner[1:]}."
        return ended(False, reason)
    return ended(
        True,
        cells=sum(m.cells for m in results),
        accepted=sum(m.accepted for m in results),
        with_level=sum(m.with_level for m in results),
        resampled=again + sum(m.resampled for m in results),
        every_cell=sample is None,
        faces=len(results),
        starts=starts,
        gradient_law=proof.exact.gradient_law,
        peaks=peaks,
        rounding=max(m.rounding for m in results),
    )


def _check_sizes(claim: Claim) -> None:
    """Refuse claims whose exact algebra would not end, and numbers whose products come near the ends of the doubles."""
    kinds = {
        (term.parameters, term.function)
        for row in (claim.drift, *claim.g1, *claim.g2)
        for terms in row
        for term in terms
    }
    uncertain = sum(p.low < p.high for p in claim.parameters)
    widest = [claim.reach * sum(abs(v) for v in row) for row in claim.coordinates]
    require(
        len(kinds) <= _MOST_KINDS,
        f"the plant has {len(kinds)} different products of parameters and functions, more than {_MOST_KINDS}",
    )
    require(
        uncertain <= _MOST_UNCERTAIN, f"{uncertain} parameters are uncertain, more than {_MOST_UNCERTAIN}"
    )
    require(
        claim.level >= _MIN_LEVEL and _MIN_REACH <= claim.reach <= _MAX_REACH,
        f"the level {claim.level:g} or the reach {claim.reach:g} is too near the ends of the doubles: another unit",
    )
    for function in claim.functions:
        require(
            not sum(abs(s) * w for s, w in zip(function.slope, widest)) > _FARTHEST,
            f"{function.name} is asked for farther than {_FARTHEST:g} from 0",
        )


def _check_matrices(claim: Claim) -> None:
    require(matrix_of(claim.coordinates).det() != 0, "the coordinates T are singular")
    r2 = matrix_of(claim.r2)
    require(r2 == r2.transpose() and positive_definite(r2), "R2 is not symmetric and positive definite")
    require(not claim.shift, "a moved equilibrium is not yet covered by this checker")


def _face(proof: Proof, chosen: EveryCell | CellSample, tick: Callable[[int], None]) -> Verification:
    with np.errstate(all="ignore"):  # NaN and infinity are not accepted
        return subdivide_face(Face(proof, chosen.face), chosen, tick=tick)


def _prove_again(proof: Proof, cells: list[ConfirmedCell], seed: int) -> int:
    rng = np.random.default_rng(seed)
    for cell in cells:
        corner = int(rng.integers(len(proof.exact_corners)))
        confirm(proof, cell.opposite() if proof.even and rng.integers(2) else cell, [corner])
    return len(cells)


def _reason(claim: Claim, refusal: Refusal) -> str:
    if refusal.z is None:
        return f"{refusal}."
    place = ", ".join(
        f"{s.name} = {v:.5g} {s.unit}".rstrip()
        for s, v in zip(claim.states, np.array(claim.coordinates) @ refusal.z, strict=True)
    )
    return f"{refusal} at {place}, where V = {refusal.value:.6g} (level {claim.level:.6g})."
