"""Robust nonlinear H∞ control of robots with elastic joints.

``import flexhinf as fh`` is quick: every public name is loaded when it is first used.
"""

from __future__ import annotations

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
from importlib import import_module

import lazy_loader

from flexhinf.drawers import on_first_use

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """A public name, loaded when it is first used; the version is that of pyproject.toml, as it was installed."""
    if name == "__version__":
        from importlib.metadata import version  # takes as long as all else of this import

        return version(__name__)
    return _public(name)


@on_first_use
def _load_drawers() -> None:
    """Import what draws results of the rooms below it."""
    for name in ("files", "pictures", "workspace_parts", "design.parts", "stored_parts"):
        import_module(f"flexhinf.pages.{name}")
