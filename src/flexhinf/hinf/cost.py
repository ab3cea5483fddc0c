"""What a solve will cost, estimated before it starts: memory, and operations for the progress bar.

Estimates of memory are right within a factor of two from about 100 MB on, which a test measures; so what is begun
must fit twice.
"""

from __future__ import annotations

import os
import sys
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

from flexhinf.errors import InvalidInput
from flexhinf.polynomial.basis import count

_LONG = 2e9  # estimated operations (about a second) below which no progress bar appears


def estimate_memory(size: tuple[int, int, int, int], degree: int, expanded: bool = False) -> int:
    """Bytes needed at the peak by `solve_hji`, tables included.

    Parameters
    ----------
    size : tuple of int
        States, disturbances, inputs, penalised outputs.
    degree : int
        Degree of V.
    expanded : bool
        With the Taylor expansion of the plant's code in states, inputs and disturbances together, whose index tuples
        stay.

    Notes
    -----
    The largest arrays are the two half-transformed tensors count(n, k−s) × count(n, s) of a change of
    variables, the insertion tables, and the gradients of the lower degrees.
    """
    n, md, m, _ = size
    highest = count(n, degree)
    tables = sum(4 * n * count(n, k - 1) + (2 * k + 8) * count(n, k) for k in range(1, degree + 1))
    pairs = 4 * degree * highest if highest > 5_000 else 0
    lower = sum(8 * (n + md + m) * count(n, k - 1) for k in range(2, degree))
    halves = [count(n, degree - s) * count(n, s) for s in range(degree + 1)]
    transform = 8 * max(a + b for a, b in pairwise(halves)) if degree > 2 else 0
    values = 8 * 10 * highest
    products = 24 * min(4_000_000, highest * degree) + 4 * sum(
        min(4_000_000, count(n, a) * count(n, k - a)) for k in range(3, degree + 1) for a in range(1, k)
    )
    plant = 2 * 8 * n * sum(count(n, k) for k in range(1, degree))  # f, and f scaled, full to degree − 1
    solve = plant + tables + pairs + lower + transform + values + products
    if not expanded:
        return solve
    monomials = [count(n + md + m, k) for k in range(degree)]
    tuples = sum(2 * k * number for k, number in enumerate(monomials))
    return max(tuples + 52 * sum(monomials), tuples + 16 * sum(monomials) + solve)


def check_memory(size: tuple[int, int, int, int], degree: int, expanded: bool = False) -> int:
    """Estimate in bytes, as `estimate_memory`; refuses what would not fit twice in the memory that is available.

    Raises
    ------
    InvalidInput
        With the estimate, what is available, and the highest degree that fits.
    """

    def needed(degree: int) -> int:
        return estimate_memory(size, degree, expanded)

    available = available_memory()
    if 2 * needed(degree) > available:
        fits = max(2, bisect_right(range(degree), available, key=lambda k: 2 * needed(k) if k > 2 else 0) - 1)
        raise InvalidInput(
            f"Degree {degree} in {size[0]} {'state' if size[0] == 1 else 'states'} does not fit in memory.",
            f"about {needed(degree) / 1e9:.3g} GB are needed, {available / 1e9:.3g} GB are available, of which half is "
            "kept for what the estimate may miss",
            f"degree {fits} is the highest that fits, with about {needed(fits) / 1e9:.3g} GB",
        )
    return needed(degree)


def available_memory() -> int:
    """Bytes that can be had without swapping, as far as the system tells."""
    try:
        with open("/proc/meminfo", encoding="ascii") as table:
            for line in table:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 1 << 62


def work(n: int, k: int) -> float:
    """Operations of one change of variables at degree `k`, which dominates that degree."""
    return float(sum(count(n, k - s - 1) * n * count(n, s + 1) for s in range(k)))


@contextmanager
def degree_progress(n: int, degree: int) -> Iterator[Callable[[int], None]]:
    """Yield a callable that reports each finished degree. The bar appears on a terminal only, on standard error."""
    total = sum(work(n, k) for k in range(3, degree + 1))
    if total < _LONG or not sys.stderr.isatty():
        yield lambda degree_done: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(f"V to degree {degree}, {n} states", total=total)
        yield lambda degree_done: bar.update(
            task, advance=work(n, degree_done), description=f"degree {degree_done} of {degree} done"
        )
