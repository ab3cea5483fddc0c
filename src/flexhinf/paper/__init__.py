"""The experiments of Elsa & Akbari (2014): runs, claims with their criteria, a verdict for each.

::

    PaperSettings ─► loop_setup ─► responses, estimators, tolerances ─► claims ─► reproduction ─► Reproduction
                     all runs      a criterion each                     apart: a second process

Enter at `reproduce`.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
