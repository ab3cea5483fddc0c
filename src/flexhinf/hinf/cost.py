"""What a solve will cost, estimated before it starts: memory, and operations for the progress bar."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

from flexhinf.errors import InvalidInput
from flexhinf.polynomial.basis import count

__all__ = ["check_memory", "degree_progress", "estimate_memory"]

_LONG = 2e9  # estimated operations (about a second) below which no progress bar appears


def estimate_memory(size: tuple[int, int, int, int], degree: int) -> int:
    """Bytes needed at the peak by `solve_hji`, tables included.

    Parameters
    ----------
    size : tuple of int
        States, disturbances, inputs, penalised outputs.
    degree : int
        Degree of V.

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
    return plant + tables + pairs + lower + transform + values + products


def check_memory(size: tuple[int, int, int, int], degree: int) -> int:
    """Estimate in bytes; refuses what would not fit.

    Raises
    ------
    InvalidInput
        With the estimate and what is available.
    """
    needed, available = estimate_memory(size, degree), available_memory()
    if needed > available:
        fits = _highest_that_fits(size, degree, available)
        raise InvalidInput(
            f"Degree {degree} in {size[0]} {'state' if size[0] == 1 else 'states'} does not fit in memory.",
            f"about {needed / 1e9:.3g} GB are needed, {available / 1e9:.3g} GB are available",
            f"degree {fits} is the highest that fits, with about {estimate_memory(size, fits) / 1e9:.3g} GB",
        )
    return needed


def _highest_that_fits(size: tuple[int, int, int, int], degree: int, available: int) -> int:
    low, high = 2, degree
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if estimate_memory(size, middle) <= available else (low, middle)
    return low


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
