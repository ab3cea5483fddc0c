"""Every error flexhinf raises on purpose, in three parts: what is wrong, what was expected and got, what to try."""

__all__ = [
    "ControllerInUse",
    "FlexhinfError",
    "InfeasibleGamma",
    "InvalidInput",
    "NoFeasibleGamma",
    "NotDetectable",
    "NotStabilisable",
    "NumericalFailure",
]


class FlexhinfError(Exception):
    """Root of all errors of flexhinf.

    Parameters
    ----------
    what : str
        One sentence: what is wrong.
    found : str
        What was expected and what was received, with the numbers.
    advice : str
        What to try.
    """

    def __init__(self, what: str, found: str = "", advice: str = "") -> None:
        self.what = what
        self.found = found
        self.advice = advice
        parts = [what]
        if found:
            parts.append(f"  found: {found}")
        if advice:
            parts.append(f"  try:   {advice}")
        super().__init__("\n".join(parts))


class InvalidInput(FlexhinfError, ValueError):
    """A value, shape, name or file that cannot be used."""


class NotStabilisable(FlexhinfError):
    """Some unstable or undamped mode cannot be reached from the input."""


class NotDetectable(FlexhinfError):
    """Some unstable or undamped mode cannot be seen (in the penalty, or in the measurement)."""


class NoFeasibleGamma(FlexhinfError):
    """No attenuation level works for this problem."""


class InfeasibleGamma(FlexhinfError):
    """The asked attenuation level is below the smallest feasible one.

    Attributes
    ----------
    gamma, gamma_star : float
        The asked level and the smallest feasible one.
    """

    def __init__(self, gamma: float, gamma_star: float) -> None:
        self.gamma = gamma
        self.gamma_star = gamma_star
        super().__init__(
            "No stabilising solution exists at this attenuation level.",
            f"expected gamma > gamma* = {gamma_star:.10g}, got gamma = {gamma:.10g}",
            f"a larger gamma, for example 1.5 * gamma* = {1.5 * gamma_star:.6g}",
        )


class NumericalFailure(FlexhinfError):
    """A computation left the finite numbers, or did not converge."""


class ControllerInUse(FlexhinfError):
    """A controller is stepped by two threads at once."""

    def __init__(self) -> None:
        super().__init__(
            "Another thread is inside a step of this controller.",
            "expected one thread at a time: a step reads and writes the controller's memory",
            "copy.copy(controller) or controller.fresh() for each thread",
        )
