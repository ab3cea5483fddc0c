"""Reports of designs, comparisons, campaigns and proofs: pages, numbers, files, terminal tables. Computes nothing."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
