"""Robust nonlinear H∞ control of robots with elastic joints.

``import flexhinf as fh`` is quick: every public name is loaded when it is first used.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
