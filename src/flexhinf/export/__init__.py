"""A controller as dependency-free C, as an FMU, as a shared library; a plant as an FMU."""

from __future__ import annotations

# Not checked strictly: lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
