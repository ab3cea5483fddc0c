"""Design of a controller from a robot and a specification, and comparison of control laws.

`pipeline` has the entry points, `design` and `compare`, and their results. What they compute is in `synthesis`,
`loop_setup`, `evaluation`, `checks`, `requirements`, `certification` and `tuning`; campaigns are in `campaign_folder`.

As an attribute of the package ``flexhinf.design`` is the function; its other names are imported from it, as in
``from flexhinf.design import Specification``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
