"""Every error flexhinf raises on purpose, in three parts: what is wrong, what was expected and got, what to try."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

#: Most characters and most lines of each part of a message: a person reads it.
LONGEST_PART, MOST_LINES = 600, 12


def readable(text: str, most: int = LONGEST_PART, lines: int = MOST_LINES) -> str:
    """A text of at most `most` characters and `lines` lines: what is cut out of its middle is counted.

    Control characters, and those that change the direction of writing, are written as Python escapes them.

    Examples
    --------
    >>> readable("a" * 10 + "b" * 80 + "c" * 10, 40)
    'aaaaaaaaaabbbbbbbbbb … 70 characters … cccccccccc'
    """
    rows = text.splitlines()
    if len(rows) > lines:
        text = "\n".join([*rows[: lines - 2], f"… {len(rows) - lines + 1} lines …", rows[-1]])
    if len(text) > most:
        head, tail = most // 2, most // 4
        text = f"{text[:head]} … {len(text) - head - tail} characters … {text[-tail:]}"
    if not text.replace("\n", "").isprintable():
        text = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)
    return text


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

    Each part is cut to a few lines, see `readable`: it may quote a whole file.

    >>> import flexhinf as fh
    >>> fh.FlexhinfError("It is too long.", "expected at most 2 m, got 3 m", "a shorter one").advice
    'a shorter one'
    """

    def __init__(self, what: str, found: str = "", advice: str = "") -> None:
        self.what, self.found, self.advice = readable(what), readable(found), readable(advice)
        rows = ("", self.what), ("  found: ", self.found), ("  try:   ", self.advice)
        super().__init__("\n".join(head + text for head, text in rows if text or not head))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy without the arguments of ``__init__``, which each subclass chooses and formats into text."""
        return type(self).__new__, (type(self), *self.args), self.__dict__


class InvalidInput(FlexhinfError, ValueError):
    """A value, shape, name or file that cannot be used.

    >>> import flexhinf as fh
    >>> try:
    ...     fh.Penalty({"link_position": -1.0})
    ... except fh.InvalidInput as error:
    ...     print(error.what)
    The weight of 'link_position' is negative.
    """


def refuse_if(wrong: object, what: str, found: str, advice: str) -> None:
    """Raise InvalidInput with these three parts if `wrong` is true.

    The texts are made in any case: they must be cheap, and must not fail where nothing is wrong.
    """
    if wrong:
        raise InvalidInput(what, found, advice)


@contextmanager
def located(where: str) -> Generator[None]:
    """Say in an error of the block where it is: "arm.toml: joint 'elbow'"."""
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error.what}", error.found, error.advice) from error


class NotStabilisable(FlexhinfError):
    """Some unstable or undamped mode cannot be reached from the input.

    >>> import flexhinf as fh
    >>> try:
    ...     fh.smallest_gamma(fh.PolynomialPlant({(1,): [1.0]}, [[1.0]], [[0.0]], {(1,): [1.0]}, 1.0))
    ... except fh.NotStabilisable:
    ...     print("the input does not reach the state")
    the input does not reach the state
    """


class NotDetectable(FlexhinfError):
    """Some unstable or undamped mode cannot be seen (in the penalty, or in the measurement).

    >>> import flexhinf as fh
    >>> try:
    ...     fh.smallest_gamma(fh.PolynomialPlant({(1,): [1.0]}, [[1.0]], [[1.0]], {(1,): [0.0]}, 1.0))
    ... except fh.NotDetectable:
    ...     print("the penalty does not see the state")
    the penalty does not see the state
    """


class NoFeasibleGamma(FlexhinfError):
    """No attenuation level holds for all tolerances of a robust design."""


class InfeasibleGamma(FlexhinfError):
    """The asked attenuation level is below the smallest feasible one.

    Attributes
    ----------
    gamma, gamma_star : float
        The asked level and the smallest feasible one.

    >>> import flexhinf as fh
    >>> try:
    ...     fh.linear_law(fh.paper_arm().problem(), gamma=0.1)
    ... except fh.InfeasibleGamma as error:
    ...     print(error.gamma < error.gamma_star)
    True
    """

    def __init__(self, gamma: float, gamma_star: float) -> None:
        self.gamma, self.gamma_star = gamma, gamma_star
        super().__init__(
            "No stabilising solution exists at this attenuation level.",
            f"expected gamma > gamma* = {gamma_star:.10g}, got gamma = {gamma:.10g}",
            f"a larger gamma, for example 1.5 * gamma* = {1.5 * gamma_star:.6g}",
        )


class NumericalFailure(FlexhinfError):
    """A computation left the finite numbers, or did not converge.

    >>> import flexhinf as fh
    >>> issubclass(fh.NumericalFailure, fh.FlexhinfError)
    True
    """


class WrongPeriod(NumericalFailure):
    """Steps come at another period than the one that a controller is made for.

    >>> import flexhinf as fh
    >>> issubclass(WrongPeriod, fh.NumericalFailure)
    True
    """

    def __init__(self, elapsed: float, period: float, slip: float) -> None:
        super().__init__(
            "The steps come at another period than the controller's.",
            f"expected one each {period:g} s, got {elapsed:g} s since the one before, and a mean that is off by "
            f"{100.0 * slip:.3g} %",
            "hold the last input and brake the robot; then a loop that keeps the period, or elapsed=0 where it is not "
            "known",
        )


class ControllerInUse(FlexhinfError):
    """A controller is stepped by two threads at once."""

    def __init__(self) -> None:
        super().__init__(
            "Another thread is inside a step of this controller.",
            "expected one thread at a time: a step reads and writes the controller's memory",
            "copy.copy(controller) or controller.fresh() for each thread",
        )
