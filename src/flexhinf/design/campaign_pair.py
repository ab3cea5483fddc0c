"""Two designs on the same samples: what they must share, and what they differ in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flexhinf.campaign import CampaignJudgement, PairedCampaigns
from flexhinf.design.campaign_setup import DesignCampaign, fields_text
from flexhinf.errors import InvalidInput

#: Folders of the two campaigns in that of their comparison.
SIDES = ("a", "b")

#: Fields of a specification that say on what robot, with which sensors and motors the law runs; all others say which
#: law that is. Start, goal and limits are compared as numbers.
SHARED = ("measured", "measurement_noise", "quantisation", "period", "delay", "extras", "move")

#: Differences that a refusal lists.
_LISTED = 6


@dataclass(frozen=True, eq=False)
class DesignPair:
    """Two designs with the same robots, sensors, motors and step.

    Parameters
    ----------
    a, b : DesignCampaign
        With the same options.

    Raises
    ------
    InvalidInput
        If their samples would not be the same: the message says what differs.
    """

    a: DesignCampaign
    b: DesignCampaign

    def __post_init__(self) -> None:
        one, other = (_circumstances(side) for side in (self.a, self.b))
        found = [
            f"{name}: {one.get(name, 'default')} ↔ {other.get(name, 'default')}"
            for name in dict.fromkeys((*one, *other))
            if one.get(name) != other.get(name)
        ]
        if not found and not _same_plant(self.a, self.b):
            found = ["the equations of the robots, which have the same parameters"]
        if found:
            more = [f"{len(found) - _LISTED} more"] if len(found) > _LISTED else []
            raise InvalidInput(
                "The designs are not for the same robot, sensors, motors and step; their runs cannot be compared "
                "sample by sample.",
                "; ".join([*found[:_LISTED], *more]),
                "designs that differ in preset, weights, degrees, γ or estimator only",
            )

    @property
    def differences(self) -> list[tuple[str, str, str]]:
        """Fields of the specifications that differ, and what they are in a and in b."""
        one, other = (fields_text(side.specification) for side in (self.a, self.b))
        return [
            (name, one.get(name, "default"), other.get(name, "default"))
            for name in dict.fromkeys((*one, *other))
            if one.get(name) != other.get(name)
        ]

    @property
    def requirements(self) -> tuple[str, ...]:
        """Those of the first design, by which both are judged."""
        return self.a.requirements


@dataclass(frozen=True, eq=False)
class PairResult:
    """Two designs that were run on the same samples.

    Attributes
    ----------
    folder : Path
        Of the comparison.
    names : (str, str)
        Of the designs, as they were given.
    judged : (CampaignJudgement, CampaignJudgement)
        Each by itself, by the same requirements.
    """

    pair: DesignPair
    folder: Path
    names: tuple[str, str]
    judged: tuple[CampaignJudgement, CampaignJudgement]
    paired: PairedCampaigns
    command: tuple[str, ...] = ()


def _circumstances(asked: DesignCampaign) -> dict[str, str]:
    """Everything stated of a campaign but what the law is."""
    limits = asked.metrics.limits
    plain = {name: text for name, text in asked.stated.items() if not name.startswith("design ")}
    fields = {name: text for name, text in fields_text(asked.specification).items() if name in SHARED}
    return {
        **plain, **fields, "true state fed back": str(asked.specification.estimator == "none"),
        "limits of the inputs": str(limits.peak.tolist()), "saturation": str(limits.saturation.tolist()),
        "limits of the speeds": str(limits.speed.tolist()),
    }  # fmt: skip


def _same_plant(a: DesignCampaign, b: DesignCampaign) -> bool:
    """Whether the true robots have the same equations."""
    codes = [one.robot.plant(one.specification.measured, extras=one.specification.extras) for one in (a, b)]
    return codes[0].code_key == codes[1].code_key
