"""What a design is exported to, by the name of ``flexhinf export NAME``: a file here has one.

C, FMU and shared library have options of their own and stand in the command line and in `flexhinf.export`. A program or
package of yours adds another export in the same way as the files here.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
