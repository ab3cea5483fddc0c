"""From a robot and a specification to a judged design, and to a comparison of laws.

`pipeline` is the way in: `design` and `compare`, one call per step. What they compute is in `synthesis`, `loop_setup`,
`evaluation`, `requirements` and `result`; what is shown of it in `report`.

The room has the name of its main function, so calling the room is calling that function: ``fh.design(robot, spec)`` and
``from flexhinf.design import design`` are the same.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import lazy_loader


class _CallableRoom(ModuleType):
    """The room as a function: importing any of its files would otherwise hide ``flexhinf.design`` the function."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """See `flexhinf.design.pipeline.design`."""
        return self.design(*arguments, **options)


__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
sys.modules[__name__].__class__ = _CallableRoom
