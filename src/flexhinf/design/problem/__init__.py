"""The problem that a specification states: `presets.choose` enters.

`modes` names modes and scales weights, `weights` finds weights for a bandwidth and a damping over a family of
linearisations, `channels` adds the tolerances as disturbance channels.
"""
