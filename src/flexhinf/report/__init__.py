"""Figures, tables, one self-contained HTML page, the folder they are written to as a whole.

::

    a table, a curve ─► blocks, figure ─► Section ─► page ─► one file of HTML ─┬─► folder ─► all files or none
                                                     numbers as JSON ──────────┘

Enter at `Page` with its sections, then at `write` of `folder`.
"""

# Not checked strictly: lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
