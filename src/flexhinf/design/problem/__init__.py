"""The H∞ problem of a specification; `presets.choose` is the entry point.

`weights` finds weights for a bandwidth and a damping over a family of linearisations, `channels` adds the tolerances as
disturbance channels.
"""
