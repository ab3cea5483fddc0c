"""Laws that can be compared with a design: a file here has one, or those of one family.

`kinds` says what a law is. A file registers its laws, each with how it is made about a pose and over a workspace; a
program or package of yours adds one in the same way.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
