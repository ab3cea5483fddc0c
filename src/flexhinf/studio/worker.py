"""Work beside the event loop: one thread, the stages of all tabs in turn, and of each tab its latest request alone.

A request is a generator: what it yields is delivered as it comes. A newer request of the same owner takes its place
between two stages, and within a stage whenever the stage asks `Ticket.check`; nothing waits in a queue that nobody
will look at. One thread makes all results, since warning filters and the caches of compiled code belong to the whole
process; the compiled loops have threads of their own.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from flexhinf.errors import FlexhinfError

#: Seconds that `Worker.stop` waits for the stage that is under way.
PATIENCE = 5.0


class Superseded(Exception):
    """A newer request has taken the place of this one."""


@dataclass(frozen=True)
class Begun:
    """A step of the work of a request that begins."""

    text: str


#: What a request computes, stage after stage: it yields a result of each.
Work: TypeAlias = "Callable[[Ticket], Iterator[object]]"


@dataclass(eq=False)
class Ticket:
    """A request: its work, and where its results go."""

    work: Work
    deliver: Callable[[object], None]
    superseded: bool = False
    stages: Iterator[object] | None = field(default=None, repr=False)

    def check(self, text: str = "") -> None:
        """Raise `Superseded` if there is a newer request; else deliver the name of the step that begins, if it has
        one."""
        if self.superseded:
            raise Superseded
        if text:
            self.deliver(Begun(text))


class Worker:
    """One thread that computes for all owners in turn."""

    def __init__(self) -> None:
        self._latest: OrderedDict[Hashable, Ticket] = OrderedDict()
        self._changed, self._ended = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name="studio", daemon=True)
        self._thread.start()

    def submit(self, owner: Hashable, work: Work, deliver: Callable[[object], None]) -> Ticket:
        """Take this request in the place of an earlier one of the owner.

        `deliver` is called on the worker's thread with every result of `work`, and with the error that ended it.
        """
        ticket = Ticket(work, deliver)
        with self._changed:
            earlier = self._latest.get(owner)
            if earlier is not None:
                earlier.superseded = True
            self._latest[owner] = ticket
            self._changed.notify()
        return ticket

    def drop(self, owner: Hashable) -> None:
        """Forget the request of an owner, as of a tab that was closed."""
        with self._changed:
            ticket = self._latest.pop(owner, None)
            if ticket is not None:
                ticket.superseded = True

    def stop(self) -> None:
        """End the thread after the stage that is under way."""
        with self._changed:
            self._ended = True
            for ticket in self._latest.values():
                ticket.superseded = True
            self._changed.notify()
        self._thread.join(PATIENCE)

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._latest and not self._ended:
                    self._changed.wait()
                if self._ended:
                    return
                owner, ticket = next(iter(self._latest.items()))
                self._latest.move_to_end(owner)  # the others come first, before its next stage
            if self._stage(ticket):
                with self._changed:
                    if self._latest.get(owner) is ticket:
                        del self._latest[owner]

    @staticmethod
    def _stage(ticket: Ticket) -> bool:
        """Compute and deliver one stage; whether it was the last one."""
        result: object
        try:
            if ticket.stages is None:
                ticket.stages = ticket.work(ticket)
            result = next(ticket.stages)
            last = False
        except (StopIteration, Superseded):
            return True
        except Exception as error:
            result, last = _as_flexhinf(error), True
        if not ticket.superseded:
            ticket.deliver(result)
        return last


def _as_flexhinf(error: Exception) -> FlexhinfError:
    """The error in three parts; of the system's and of unforeseen ones, what is known of them."""
    if isinstance(error, FlexhinfError):
        return error
    found = f"expected a result, got {type(error).__name__}: {str(error) or 'no more is known'}"
    if isinstance(error, (OSError, MemoryError)):
        return FlexhinfError(
            "The system refuses what this needs.", found, "more room or memory, another name"
        )
    return FlexhinfError("This could not be computed.", found, "other settings; the last good result stays")
