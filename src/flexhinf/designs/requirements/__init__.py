"""Requirements of a specification: what each is, how it is measured, and its limit.

A file here is one requirement with the field of its limit, or a few that are measured alike; `runs` has those that need
more than one motion or loop. A program or package of yours adds one in the same way. `flexhinf.designs.judge` judges.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
