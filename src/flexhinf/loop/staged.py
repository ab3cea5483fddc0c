"""Whether a law or an estimator may be composed: what it says about its stages must be what it computes."""

from __future__ import annotations

__all__ = ["offers"]


def offers(part: object, stages: str, *texts: str) -> bool:
    """Does `part` have `stages`, and does no subclass give another meaning to the texts they stand for?

    A user's class that overrides the text alone (``time_update``) must not run by the stages of the class it
    comes from.

    Parameters
    ----------
    part : object
    stages : str
        Name of the method that says how to compose.
    texts : str
        Names of the methods that say the same as plain code.
    """

    def depth(name: str) -> int:
        order = type(part).__mro__
        return next((k for k, kind in enumerate(order) if name in vars(kind)), len(order))

    here = depth(stages)
    return here < len(type(part).__mro__) and all(here <= depth(text) for text in texts)
