"""Batches that are drawn and filled beside the runs of others: the same rows, and an end that makes none in vain."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np
import pytest
from tests.campaign.conftest import made_campaign, tolerances

from flexhinf.campaign import Campaign, batches, driver, run_batch, samples
from flexhinf.campaign.batches import Rows
from flexhinf.errors import InvalidInput
from flexhinf.processors import limited_threads


def same(rows: Rows, others: Rows) -> bool:
    pairs = ((column, others[name]) for name, column in rows.items())
    return rows.keys() == others.keys() and all(
        np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs
    )


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("order", [1, -1])
def test_rows_are_those_of_each_batch_alone_in_any_order(
    threads: int, order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batches, "TRACED", 20)
    campaign = made_campaign(samples=70, batch=8)
    alone = [run_batch(campaign, batch) for batch in range(campaign.batches)]
    with limited_threads(threads):
        together = dict(driver.in_this_process(campaign, range(campaign.batches)[::order]))
    assert all(same(together[batch], rows) for batch, rows in enumerate(alone))
    kept = np.concatenate([rows["trace.position"] for rows in alone])
    assert not np.isnan(kept[:20]).any()
    assert np.isnan(kept[20:]).all()


@pytest.mark.parametrize("cause", ["refused", "closed"])
def test_an_end_before_the_last_batch_runs_no_more_of_them(
    cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign, ran, stopped = made_campaign(samples=400, batch=4), list[int](), threading.Event()
    stop = driver._Turn.stop

    def stopped_now(turn: driver._Turn) -> None:
        stop(turn)
        stopped.set()

    def counted(own: Campaign, some: Sequence[int], turn: batches.Turn, *more: object) -> list[Rows]:
        with turn:
            ran.extend(some)
            if cause == "closed" and 1 in some:
                assert stopped.wait(60.0)
            if cause == "refused" and 1 in some:
                raise InvalidInput("The second is refused.", "expected others", "one of them")
            return [{"sample": np.array(own.indices(batch))} for batch in some]

    monkeypatch.setattr(driver, "run_batches", counted)
    monkeypatch.setattr(driver._Turn, "stop", stopped_now)
    with limited_threads(2):
        made = driver.in_this_process(campaign, range(100))
        assert next(made)[0] == 0
        if cause == "refused":
            with pytest.raises(InvalidInput, match="second"):
                next(made)
        made.close()
    assert ran == [0, 1]


def test_a_users_code_is_called_in_the_thread_of_the_campaign_alone() -> None:
    callers = set[threading.Thread]()

    def draw(generator: np.random.Generator) -> dict[str, float]:
        callers.add(threading.current_thread())
        return {"mass": generator.uniform(0.9, 1.1)}

    def built(numbers: samples.Columns) -> samples.Sample:
        callers.add(threading.current_thread())
        return samples.Sample({"mass": numbers["mass"]})

    built_by_user = tolerances()
    object.__setattr__(built_by_user, "build", built)
    with limited_threads(2):
        for own in (draw, built_by_user):
            assert (
                len(list(driver.in_this_process(made_campaign(draw=own, samples=12, batch=4), range(3)))) == 3
            )
    assert callers == {threading.current_thread()}
