"""Requirements of a specification: what each is, how it is measured, and its limit.

A file here is one requirement that is measured on motions or loops; `loop_margins` and `runs` have those that need more
than one of these. A program or package of yours adds one in the same way.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
