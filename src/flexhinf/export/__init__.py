"""A controller as dependency-free C, as an FMU, as a shared library; a plant as an FMU.

::

    Controller ─► controller_c ─┬─► package ──► C99 with its tests, ros2
                                ├─► fmu ──────► an archive for Simulink and others
                                ├─► compiled ─► a shared library ─► realtime, ros_node
                                └─► web ──────► a page with WebAssembly

Enter at `export_c`, `export_fmu`, `compile_controller`, `run_realtime`, `run_ros`, or at `web.page.write_page`.
"""

from __future__ import annotations

# Not checked strictly: lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
