"""Robust nonlinear H∞ control of robots with elastic joints.

``import flexhinf as fh`` is quick: every public name is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import lazy_loader

__version__ = "0.2.0"

_getattr, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A public name. The room ``flexhinf.design`` is itself callable, whichever of its files was imported before."""
    return import_module("flexhinf.design") if name == "design" else _getattr(name)
