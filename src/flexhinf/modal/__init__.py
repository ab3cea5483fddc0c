"""One law for the whole workspace: an arm as pairs of a link and a motor, with gains that are functions of M(q).

With K^½ M(q)⁻¹ K^½ = V Λ Vᵀ, z = Vᵀ K^½ q and w = Vᵀ K^½ θ an arm of n elastic joints is n pairs: `pair`. The gains of
a pair are functions of its λ alone, so one table serves every pose: `law`. `tolerance` says which errors of the model
every pair stands at once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
