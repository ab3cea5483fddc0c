"""From a specification to a law: `steps` is the entry point, with the search of the preset robust on the running loop.

`noise` finds R^v of the estimator, `by_step` bandwidths within the limits of the joints and the degree of V.
"""
