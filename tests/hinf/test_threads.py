"""Threads give the same result as none."""

from __future__ import annotations

import numpy as np

from flexhinf.hinf import contraction, homological as transform
from flexhinf.polynomial import basis


def test_two_threads_compute_the_same(monkeypatch):
    n, k = 9, 4
    rng = np.random.default_rng(0)
    entries, matrix = rng.standard_normal(basis.count(n, k)), rng.standard_normal((n, n))
    monkeypatch.setattr(transform, "_SMALL", 0)
    monkeypatch.setattr(transform, "_WORTH", 0)
    monkeypatch.setattr(transform, "_TILE_BYTES", 5_000)
    monkeypatch.setattr(contraction, "_ROWS", 4)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    alone = transform.change_variables(entries, n, k, matrix)
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert np.array_equal(transform.change_variables(entries, n, k, matrix), alone)
