"""Robust nonlinear H∞ control of robots with elastic joints.

``import flexhinf as fh`` is quick: every public name is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module

import lazy_loader

__version__ = "0.2.0"

# Python makes a subpackage an attribute of its package when it first loads it. `flexhinf.design` is also the name of a
# function, so that is done here, once, and undone: ``fh.design`` is the function, however rooms are imported.
import_module(f"{__name__}.design")
del globals()["design"]

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
