"""One controller for a workspace: `design` is the entry point.

`setup` is a law with its estimator at any pose, `search` finds both, `judgement` has the requirements.
"""
