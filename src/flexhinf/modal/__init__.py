"""One law for the whole workspace: an arm as pairs of a link with a motor, their gains as functions of M(q).

::

    a range of λ, PairWeights ─► pair ─► PairGains ─┬─► law ─► ModalLaw, a Law at every pose
                                                    ├─► popov, tolerance ─► errors that all pairs tolerate
                                                    └─► stability ─► ProvedRange

With K^½ M(q)⁻¹ K^½ = V Λ Vᵀ, z = Vᵀ K^½ q and w = Vᵀ K^½ θ an arm of n elastic joints is n pairs. The gains of a pair
depend on its λ alone, so one table serves every pose. `pair` has the gains of a pair, `law` the law of the arm.
`popov` searches for what proves which errors of mass all pairs tolerate, `tolerance` computes it of any linear errors;
`stability` proves for which λ a pair is stable without errors. Enter at `pair_gains`, then at `ModalLaw`.
"""

# Not checked strictly: lazy_loader has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
