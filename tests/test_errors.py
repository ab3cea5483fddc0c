"""Errors travel: between processes, and as copies."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from inspect import signature
from multiprocessing import get_context
from types import SimpleNamespace

import numpy as np
import pytest

import flexhinf
from flexhinf.certify.proof import NotProved
from flexhinf.cli.commands import app  # noqa: F401  (so that every room, and every class of error, is loaded)
from flexhinf.errors import FlexhinfError, InfeasibleGamma, WrongPeriod


def _kinds(kind: type[FlexhinfError] = FlexhinfError) -> Iterator[type[FlexhinfError]]:
    yield kind
    for below in kind.__subclasses__():
        yield from _kinds(below)


def _made(kind: type[FlexhinfError]) -> FlexhinfError:
    if kind is InfeasibleGamma:
        return kind(1.5, 2.0)
    if kind is NotProved:
        outcome = SimpleNamespace(reason="it fails", point=np.array([0.5]), value=0.9, residual=1e-3, cells=7)
        return kind(SimpleNamespace(coordinates=((1.0,),), level=1.0), outcome)
    if kind is WrongPeriod:
        return kind(1.5e-3, 1e-3, 0.5)
    needed = [
        p
        for p in signature(kind).parameters.values()
        if p.default is p.empty and p.kind is p.POSITIONAL_OR_KEYWORD
    ]
    return kind(*["What is wrong: 1\n2.", "expected 1, got 2", "another"][: len(needed)])


@pytest.mark.parametrize("kind", sorted(_kinds(), key=lambda kind: (kind.__module__, kind.__qualname__)))
def test_every_error_pickles_and_copies_whole(kind):
    error = _made(kind)
    error.add_note("in sample 7")
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
        assert type(again) is kind
        assert str(again) == str(error)
        assert vars(again) == vars(error)


def _infeasible(ratio: float) -> None:
    plant = flexhinf.PolynomialPlant({(1,): [-1.0]}, [[1.0]], [[1.0]], {(1,): [1.0]}, 1.0)
    flexhinf.solve_hji(plant, ratio * flexhinf.smallest_gamma(plant), 4)


@pytest.mark.ci("starts a pool of processes")
def test_an_infeasible_level_reaches_the_parent_of_a_pool():
    with get_context("spawn").Pool(1) as pool:
        future = pool.map_async(_infeasible, [0.5])
        with pytest.raises(InfeasibleGamma) as caught:
            future.get(60)
    assert caught.value.gamma == pytest.approx(0.5 * caught.value.gamma_star)
