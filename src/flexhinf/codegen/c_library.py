"""Addresses of the C mathematical library in this process."""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache

from flexhinf.codegen.unsupported import Unsupported

_NAMES = {"win32": ("ucrtbase", "msvcrt"), "darwin": ("libm.dylib",)}


def addresses(library: dict[str, str]) -> dict[str, int]:
    """Where each function lies.

    Parameters
    ----------
    library : dict of str to str
        Name used in the machine code to name in the C library.

    Returns
    -------
    dict of str to int

    Raises
    ------
    Unsupported
        A function that this C library does not have.
    """
    return {emitted: _address(name) for emitted, name in library.items()}


@cache
def _address(name: str) -> int:
    for library in _libraries():
        function = getattr(library, name, None)
        if function is not None:
            address = ctypes.cast(function, ctypes.c_void_p).value
            if address:
                return address
    raise Unsupported("The C library lacks a function.", f"'{name}' was not found on {sys.platform}")


@cache
def _libraries() -> tuple[ctypes.CDLL, ...]:
    found = [] if os.name == "nt" else [ctypes.CDLL(None)]
    for name in _NAMES.get(sys.platform, ("libm.so.6", "libm.so")):
        try:
            found.append(ctypes.CDLL(name))
        except OSError:
            continue
    return tuple(found)
