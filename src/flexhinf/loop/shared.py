"""Traced and compiled code that many loops share: made once for each model and law, whatever their numbers are.

Parameters, noise covariances and law coefficients are data, so plants of a campaign and laws of a sweep
differ in nothing that is compiled.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

__all__ = ["share"]

CAPACITY = 128

_kept: OrderedDict[Hashable, Any] = OrderedDict()
_lock = threading.RLock()


def share(key: Hashable, build: Callable[[], Any]) -> Any:
    """What `build` made for this key, made only once; the least recently used is forgotten past `CAPACITY`.

    A key with something that cannot be hashed (a model's code as an unhashable object) is not kept.
    """
    try:
        hash(key)
    except TypeError:
        return build()
    with _lock:
        if key in _kept:
            _kept.move_to_end(key)
        else:
            _kept[key] = build()
            while len(_kept) > CAPACITY:
                _kept.popitem(last=False)
        return _kept[key]
