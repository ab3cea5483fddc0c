"""Faults of a description: raised at the first one, or collected where all of them are asked for."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from flexhinf.errors import InvalidInput


@dataclass(frozen=True)
class PartFault:
    """A fault of links or joints, with the three parts of an error; `kind` says what helps."""

    kind: str
    parts: tuple[str, ...]  # names of links or joints
    what: str
    found: str
    advice: str


#: Kinds of faults that `flexhinf init` knows a way round.
NO_BODY, NO_MASS, NO_EXTENT, NO_ROOM, NO_KIND = "no body", "no mass", "no extent", "no room", "no kind"

_collected: ContextVar[list[PartFault] | None] = ContextVar("_collected", default=None)


@contextmanager
def collected_faults() -> Generator[list[PartFault]]:
    """In this block `refuse_part` collects faults into the list, and readers go on."""
    faults = list[PartFault]()
    token = _collected.set(faults)
    try:
        yield faults
    finally:
        _collected.reset(token)


def collects_faults() -> bool:
    """Whether faults are collected here."""
    return _collected.get() is not None


def refuse_part(wrong: object, kind: str, parts: tuple[str, ...], what: str, found: str, advice: str) -> bool:
    """Raise InvalidInput if `wrong` is true, or collect the fault; whether there is one."""
    if not wrong:
        return False
    faults = _collected.get()
    if faults is None:
        raise InvalidInput(what, found, advice)
    faults.append(PartFault(kind, parts, what, found, advice))
    return True
