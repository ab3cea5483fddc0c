"""The H∞ problem of a specification; `presets.choose` is the entry point.

`weights` has the linear part: a family of linearisations, the H∞ gain of the nominal robot and of all within the
tolerances, and the search of weights for a bandwidth and a damping. `presets` makes tolerances disturbance channels.
"""
