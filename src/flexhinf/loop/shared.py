"""Traced and compiled code that many loops share: made once for each model and law, whatever their numbers are.

Parameters, noise covariances and law coefficients are data, so plants of a campaign and laws of a sweep
differ in nothing that is compiled.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any

CAPACITY = 128


@dataclass
class _Entry:
    lock: Any = field(default_factory=threading.RLock)
    built: bool = False
    value: Any = None


_kept: OrderedDict[Hashable, _Entry] = OrderedDict()
_lock = threading.Lock()  # of the table alone


def share(key: Hashable, build: Callable[[], Any]) -> Any:
    """What `build` made for this key, made only once; the least recently used is forgotten past `CAPACITY`.

    A key with something that cannot be hashed (a model's code as an unhashable object) is not kept.
    """
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
    return entry.value


def _forget_the_parents_threads() -> None:
    """In a forked process: nobody holds a lock, and nobody goes on with what another thread was building."""
    global _lock
    _lock = threading.Lock()
    for key, entry in list(_kept.items()):
        if entry.built:
            entry.lock = threading.RLock()
        else:
            del _kept[key]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_the_parents_threads)
