"""From a specification to a law: `steps` enters and calls the searches on running loops.

`noise` finds R^v of the estimator, `effort_limit` bandwidths within the limits of the joints, `degrees` the degree
of V, `whole_loop` weights and noise levels of the preset robust.
"""
