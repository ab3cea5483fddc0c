"""The H∞ problem of a specification; `presets.choose` is the entry point.

`modes` names modes and scales weights, `weights` finds weights for a bandwidth and a damping over a family of
linearisations, `channels` adds the tolerances as disturbance channels.
"""
