"""From a specification to a law: `steps` is the entry point and calls the searches on running loops.

`noise` finds R^v of the estimator, `by_step` bandwidths within the limits of the joints and the degree of V,
`whole_loop` weights and noise levels of the preset robust.
"""
