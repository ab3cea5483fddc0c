"""What became of every attempt of a fuzzer."""

from __future__ import annotations

from dataclasses import dataclass, field

from flexhinf.errors import FlexhinfError

__all__ = ["Tally"]

LONGEST_MESSAGE = 2000
"""Characters: an error that a person is to read is a few lines."""


@dataclass
class Tally:
    """Counts of one fuzzer; ``wrong`` says what was neither right nor refused by a typed error.

    Attributes
    ----------
    what : str
        What was tried, in a few words: a row of the table.
    right, typed : int
        Attempts that gave a right answer; attempts refused by a :class:`FlexhinfError` of a readable length, or
        answered with a typed diagnosis that the answer is not right.
    wrong : list of str
        One line for every other attempt: how to repeat it, and what came of it.
    """

    what: str
    right: int = 0
    typed: int = 0
    wrong: list[str] = field(default_factory=list)

    @property
    def tried(self) -> int:
        """All attempts."""
        return self.right + self.typed + len(self.wrong)

    def answered(self, fault: str = "", how: str = "") -> None:
        """Count an attempt that returned: right, unless a fault of the answer is named."""
        if fault:
            self.wrong.append(f"{how}: {fault}")
        else:
            self.right += 1

    def raised(self, error: BaseException, how: str) -> None:
        """Count an attempt that raised: typed where the error is ours and readable."""
        if not isinstance(error, FlexhinfError):
            self.wrong.append(f"{how}: {type(error).__name__}: {str(error)[:200]}")
        elif len(str(error)) > LONGEST_MESSAGE:
            self.wrong.append(f"{how}: a message of {len(str(error))} characters")
        else:
            self.typed += 1
