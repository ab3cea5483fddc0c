"""The report of a design and of a comparison: pages, numbers, files and terminal tables. Computes nothing."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
