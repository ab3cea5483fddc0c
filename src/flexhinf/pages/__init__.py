"""Reports of designs, comparisons, campaigns, proofs: pages, numbers, files, terminal tables. Computes nothing.

::

    Design, a campaign, a log ─► page, workspace, campaign ─► blocks of report ─► files ─► a folder
                                 sections of pages.design   └─► terminal ─► one screen

Enter at the pair of a result: `design_files` writes, `ending` ends the command; `write_report` does both for Python.
"""

# Not checked strictly: lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
