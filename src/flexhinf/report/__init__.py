"""Figures, tables, one self-contained HTML page, and the folder they are written to as a whole."""

# Not checked strictly: lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
