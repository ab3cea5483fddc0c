"""Both cores, where an array is large enough for it to pay, and the same bits from any number of them.

A BLAS that shares one product among threads adds its terms in another order for another number of them. So large
products are cut into tiles of a fixed size, each below where BLAS starts threads, and the tiles are shared.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

_TILE_PRODUCTS = 200_000  # multiplications of a real tile: OpenBLAS starts threads from 262,144 on
_COMPLEX = 4  # and for complex numbers from a fourth of that on
_TILE_ROWS = 64
_LARGE = 20_000_000  # multiplications from which the tiles are worth a second thread


def thread_count() -> int:
    """Threads to use: OMP_NUM_THREADS if it is set, else the processors this process may run on."""
    wanted = os.environ.get("OMP_NUM_THREADS", "")
    if wanted.isdigit() and int(wanted) > 0:
        return int(wanted)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def tile_products(kind: np.dtype) -> int:
    """Multiplications that a product of numbers of this kind may take without BLAS sharing it among threads."""
    return _TILE_PRODUCTS // _COMPLEX if kind.kind == "c" else _TILE_PRODUCTS


def matrix_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """`left` @ `right`, the same bits for any number of threads.

    Parameters
    ----------
    left, right : ndarray, shapes (rows, inner), (inner, columns)
    """
    (rows, inner), columns = left.shape, right.shape[1]
    kind = np.result_type(left, right)
    most = tile_products(kind)
    if rows * inner * columns <= most:
        return left @ right
    wide = min(columns, max(1, most // (inner * min(rows, _TILE_ROWS))))
    high = max(1, most // (inner * wide))
    result = np.empty((rows, columns), kind)

    def multiply(top: int, begin: int) -> None:
        np.matmul(
            left[top : top + high],
            right[:, begin : begin + wide],
            out=result[top : top + high, begin : begin + wide],
        )

    tiles = ((top, begin) for top in range(0, rows, high) for begin in range(0, columns, wide))
    run_all(multiply, tiles, large=rows * inner * columns > _LARGE)
    return result


def run_all(task: Callable[..., None], arguments: Iterable[tuple[Any, ...]], large: bool) -> None:
    """Call `task` on each tuple of arguments, side by side if `large`; the calls must be independent.

    NumPy releases the interpreter while it gathers and multiplies, so plain threads are enough.
    """
    threads = thread_count() if large else 1
    if threads == 1:
        for argument in arguments:
            task(*argument)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(lambda argument: task(*argument), arguments):
            pass
