"""What is judged by requirements."""

from __future__ import annotations

from flexhinf.designs.requirements import Requirement


class Judged:
    """Base of what is judged by requirements."""

    requirements: tuple[Requirement, ...]

    @property
    def missed(self) -> tuple[Requirement, ...]:
        """Requirements that are not met."""
        return tuple(line for line in self.requirements if line.missed)

    @property
    def met(self) -> bool:
        """Whether every requirement is met."""
        return all(line.met for line in self.requirements)

    @property
    def judgement(self) -> str:
        """Whether they are met, for a summary."""
        return f"{len(self.missed)} of {len(self.requirements)} not met" if self.missed else "met"
