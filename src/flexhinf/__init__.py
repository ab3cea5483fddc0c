"""Robust nonlinear H∞ control of robots with elastic joints.

``import flexhinf as fh`` is quick: every public name is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

# Python makes a subpackage an attribute of its package when it first loads it. `flexhinf.design` is also the name of a
# function, so that is done here, once, and undone: ``fh.design`` is the function, however rooms are imported.
import_module(f"{__name__}.design")
del globals()["design"]

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """A public name, loaded when it is first used; the version is that of pyproject.toml, as it was installed."""
    if name == "__version__":
        from importlib.metadata import version  # takes as long as all else of this import

        return version(__name__)
    return _public(name)
