"""Estimators that a design can have, by the name of ``--estimator``: a file here has one, or those of one family.

A program or package of yours adds one in the same way.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
