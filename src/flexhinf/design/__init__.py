"""From a robot and a specification to a judged design, and to a comparison of laws.

`pipeline` is the way in: `design` and `compare`, one call per step. What they compute is in `synthesis`, `loop_setup`,
`evaluation`, `requirements` and `result`.

As an attribute of the package ``flexhinf.design`` is the function; names of the room are imported from it, as in
``from flexhinf.design import Specification``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
