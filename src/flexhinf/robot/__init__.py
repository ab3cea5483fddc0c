"""Robots: physical parameters with tolerances and sources, and the plants made of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
