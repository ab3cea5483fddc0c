"""Claims that another process judges."""

from __future__ import annotations

import multiprocessing

import pytest

from flexhinf import processors
from flexhinf.paper import PaperSettings
from flexhinf.paper.apart import judged_apart
from flexhinf.paper.claims import BY_LENGTH, CLAIMS
from flexhinf.paper.loop_setup import PaperSetup, judge


@pytest.fixture
def two_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")


@pytest.mark.ci("two processes judge the two longest claims")
def test_another_process_judges_as_this_one(two_processors: None) -> None:
    settings = PaperSettings(estimator="none", process_noise=0.0, period=0.02)  # few samples
    setup = PaperSetup(settings)
    with judged_apart(settings) as apart:
        assert apart is not None
        apart.begun[1] = len(BY_LENGTH) - 2  # this one judges all but the two longest
        for stated in BY_LENGTH[:2]:
            there = apart.judged()
            assert there is not None
            assert there.as_dict() == judge(setup, stated).as_dict()
        assert apart.judged() is None
        assert list(apart.begun) == [2, len(BY_LENGTH) - 2]


def test_every_claim_is_judged_once_and_the_longest_come_first() -> None:
    assert sorted(claim.id for claim in BY_LENGTH) == sorted(claim.id for claim in CLAIMS)


def test_of_a_process_that_died_nothing_is_waited_for(two_processors: None) -> None:
    with judged_apart(PaperSettings()) as apart:
        assert apart is not None
        (worker,) = multiprocessing.active_children()
        worker.kill()
        assert apart.judged() is None
    assert multiprocessing.active_children() == []


def test_the_process_ends_with_an_interruption(two_processors: None) -> None:
    with pytest.raises(KeyboardInterrupt), judged_apart(PaperSettings()):
        raise KeyboardInterrupt
    assert multiprocessing.active_children() == []


def test_one_processor_has_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS")  # else it says how many there are
    monkeypatch.setattr(processors, "available", lambda: 1)
    with judged_apart(PaperSettings()) as apart:
        assert apart is None
        assert multiprocessing.active_children() == []
