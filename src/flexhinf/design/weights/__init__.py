"""What a synthesis is made of: weights from a behaviour, channels of the tolerances, noise levels of the estimator.

`choose` enters: it returns the problem of a specification. `search` finds weights for a bandwidth and a damping over a
family of linearisations; `robust` adds the tolerances as disturbance channels; `estimator_noise` finds R^v afterwards.
"""
