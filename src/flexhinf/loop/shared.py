"""Traced and compiled code that many loops share: made once for each model and law, whatever their numbers are.

Parameters, noise covariances and law coefficients are data, so plants of a campaign and laws of a sweep
differ in nothing that is compiled.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from types import SimpleNamespace
from typing import Any

CAPACITY = 128

#: Path time while a motion is braked to rest, in units of the braking time, as a polynomial of the fraction of it that
#: has passed: half of the path time of the same interval. Its rate falls from 1 to 0 with three continuous derivatives,
#: so that the torque of an elastic joint, which the fourth derivative of the position enters, does not jump.
BRAKING = (0.0, 1.0, 0.0, 0.0, 0.0, -7.0, 14.0, -10.0, 2.5)


#: By key: what was built for it, whether it was, and the lock of whoever builds it.
_kept: OrderedDict[Hashable, Any] = OrderedDict()
_lock = threading.Lock()  # of the table alone


def share(key: Hashable, build: Callable[[], Any]) -> Any:
    """The result of `build` for this key, computed only once; the least recently used is dropped past `CAPACITY`.

    A key with something that cannot be hashed (a model's code as an unhashable object) is not kept.
    """
    try:
        hash(key)
    except TypeError:
        return build()
    with _lock:
        entry = _kept.setdefault(key, SimpleNamespace(lock=threading.RLock(), built=False, value=None))
        _kept.move_to_end(key)
        while len(_kept) > CAPACITY:
            _kept.popitem(last=False)
    with entry.lock:
        if not entry.built:
            entry.value, entry.built = build(), True
    return entry.value


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
