"""Traced and compiled code that many loops and filters share, whatever their numbers are: made once for each model.

Parameters, noise covariances and law coefficients are data, so plants of a campaign and laws of a sweep
differ in nothing that is compiled.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import TypeVar, cast

from flexhinf.codegen.compiler import highest_optimisation

CAPACITY = 128

Built = TypeVar("Built")


@dataclass
class _Entry:
    """What was built for a key, whether it was, and the lock of whoever builds it."""

    lock: threading.RLock = field(default_factory=threading.RLock)
    built: bool = False
    value: object = None


_kept: OrderedDict[Hashable, _Entry] = OrderedDict()
_lock = threading.Lock()  # of the table alone


def share(key: Hashable, build: Callable[[], Built]) -> Built:
    """The result of `build` for this key, computed only once; the least recently used is dropped past `CAPACITY`.

    Code of another level of optimisation (`highest_optimisation`) is another result. A key with something that cannot
    be hashed (a model's code as an unhashable object) is not kept.
    """
    key = (highest_optimisation(), key)
    try:
        hash(key)
    except TypeError:
        return build()
    with _lock:
        entry = _kept.setdefault(key, _Entry())
        _kept.move_to_end(key)
        while len(_kept) > CAPACITY:
            _kept.popitem(last=False)
    with entry.lock:
        if not entry.built:
            entry.value, entry.built = build(), True
    return cast(Built, entry.value)


def _forget_the_parents_threads() -> None:
    global _lock
    _lock = threading.Lock()
    for key, entry in list(_kept.items()):
        if entry.built:
            entry.lock = threading.RLock()
        else:
            del _kept[key]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_the_parents_threads)
