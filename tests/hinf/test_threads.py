"""Threads give the same result as none."""

from __future__ import annotations

import os

import numpy as np

from flexhinf.hinf import contraction, homological as transform
from flexhinf.polynomial import algebra as threads, basis


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


def test_number_of_threads_follows_the_environment(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert threads.thread_count() == 3
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert 1 <= threads.thread_count() <= (os.cpu_count() or 1)
