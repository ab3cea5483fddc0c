"""The latest request of each owner wins, and no owner waits for the stages of another."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.studio.worker import Begun, Ticket, Worker

SECONDS = 20.0


@pytest.fixture
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.stop()


class Delivered(list[Any]):
    def __init__(self, last: Any) -> None:
        super().__init__()
        self.last, self.done = last, threading.Event()

    def __call__(self, result: Any) -> None:
        self.append(result)
        if result == self.last or isinstance(result, Exception):
            self.done.set()


def test_a_newer_request_takes_the_place_of_an_older_one(worker: Worker) -> None:
    begun, go_on, results = threading.Event(), threading.Event(), Delivered("new")

    def slow(ticket: Ticket) -> Iterator[str]:
        begun.set()
        go_on.wait(SECONDS)
        ticket.check()
        yield "old"

    worker.submit("tab", slow, results)
    assert begun.wait(SECONDS)
    for _ in range(50):  # of which only the last is ever computed
        worker.submit("tab", lambda ticket: iter(["never"]), results)
    worker.submit("tab", lambda ticket: iter(["new"]), results)
    go_on.set()
    assert results.done.wait(SECONDS)
    assert results == ["new"]


def test_what_begins_is_told_before_its_result(worker: Worker) -> None:
    results = Delivered("law")

    def work(ticket: Ticket) -> Iterator[str]:
        ticket.check("degree 2: solve")
        yield "law"

    worker.submit("tab", work, results)
    assert results.done.wait(SECONDS)
    assert results == [Begun("degree 2: solve"), "law"]


def test_owners_take_turns(worker: Worker) -> None:
    order: list[str] = []
    started, first, second = threading.Event(), Delivered("a3"), Delivered("b1")

    def many(ticket: Ticket) -> Iterator[str]:
        assert started.wait(SECONDS)
        for k in range(4):
            order.append(f"a{k}")
            yield f"a{k}"

    def single(ticket: Ticket) -> Iterator[str]:
        order.append("b1")
        yield "b1"

    worker.submit("a", many, first)
    worker.submit("b", single, second)
    started.set()
    assert first.done.wait(SECONDS)
    assert second.done.wait(SECONDS)
    assert order.index("b1") <= 1


def test_errors_are_delivered_in_three_parts(worker: Worker) -> None:
    for raised in (InvalidInput("what", "found", "advice"), ZeroDivisionError("here"), OSError("full")):
        results = Delivered(None)

        def failing(ticket: Ticket, raised: Exception = raised) -> Iterator[str]:
            raise raised
            yield ""

        worker.submit("tab", failing, results)
        assert results.done.wait(SECONDS)
        (error,) = results
        assert isinstance(error, FlexhinfError)
        assert error.what
        assert error.found
        assert error.advice


def test_a_closed_tab_gets_nothing(worker: Worker) -> None:
    begun, go_on, results, later = threading.Event(), threading.Event(), Delivered("x"), Delivered("y")

    def slow(ticket: Ticket) -> Iterator[str]:
        begun.set()
        go_on.wait(SECONDS)
        yield "x"

    worker.submit("closed", slow, results)
    assert begun.wait(SECONDS)
    worker.drop("closed")
    go_on.set()
    worker.submit("open", lambda ticket: iter(["y"]), later)
    assert later.done.wait(SECONDS)
    assert results == []
