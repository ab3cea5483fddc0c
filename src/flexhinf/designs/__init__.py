"""Design of a controller for a robot by a specification; comparison of control laws.

::

    Robot, Specification ─► pipeline ─┬─► workspace ─────────────► WorkspaceEvidence ─┐
                                      └─► synthesis, evaluation ─► PoseEvidence ──────┴─► Design ─┬─► stored, pages
                          laws, estimators, requirements: a file each                             ├─► campaign_folder
                                                                                                  └─► exports

Enter at `pipeline`: `design`, and `compare` for several laws. The default task is `workspace`: one law for all poses,
with its search, its judgement and its proof. A design of one pose goes through `problem`, `synthesis`, `loop_setup`,
`evaluation`, `checks` and `certification`. `load_design` of `stored` gives a design back from its folder.
"""

# lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
