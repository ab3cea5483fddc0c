"""The kinds and sides of faults, with the sizes that each may have.

A size x is drawn log-uniformly between `low` and `high`; `form` says what `faults.c` makes of it. Where a smallest size
has been measured that moves the arm by 0.05 rad while nothing stops it, that is the lower end.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

__all__ = ["FAULTS", "GROUPS", "HARMLESS", "MOVES", "OUTSIDE", "TRIPS", "Facts", "Fault", "drawn", "fitting"]

#: Longer than any run: low, high, unit.
EVER = (1e6, 1e6, "s")
#: A run goes on for so long behind its fault, s, and begins with a move: faults come within these times, s.
LASTS, EARLIEST, LATEST = 3.6, 0.5, 1.6

#: What becomes of a size, by its form; the sign is +1 or −1, T the period of the controller, s.
FORMS: Mapping[str, Callable[[float, float, float], float]] = {
    "signed": lambda x, sign, T: sign * x,
    "size": lambda x, sign, T: x,
    "more": lambda x, sign, T: 1.0 + x,
    "less": lambda x, sign, T: 1.0 / (1.0 + x),
    "rest": lambda x, sign, T: 1.0 - x,
    "samples": lambda x, sign, T: max(1.0, round(x / T)),
}


@dataclass(frozen=True)
class Facts:
    """What of an arm decides which faults it may have; payload (low, high) in kg, period in s."""

    joints: int
    links: bool
    motors: bool
    drive: str
    payload: tuple[float, float]
    period: float
    brakes: bool


@dataclass(frozen=True)
class Fault:
    """A kind of fault on one side.

    `kind`: its name in `faults.c`. `side`: "link", "motor" or "both" of a joint's sensors, "one" joint or "all".
    `low`, `high`: of the size in `unit`; equal where there is but one. `starts`: it is there from the start. `needs`:
    what an arm must have. `hidden`: why its sensors cannot show it, `slow`: why it shows late; "" where they can, or it
    does not.
    """

    name: str
    kind: str
    side: str
    about: str
    low: float = 1.0
    high: float = 1.0
    unit: str = ""
    form: str = "size"
    starts: bool = False
    needs: Callable[[Facts], bool] = field(default=lambda facts: True)
    lasts: float = LASTS
    hidden: Callable[[Facts], str] = field(default=lambda facts: "")
    slow: Callable[[Facts], str] = field(default=lambda facts: "")

    @property
    def gradual(self) -> bool:
        """Whether a reading becomes wrong little by little."""
        return self.kind in ("scaled", "slips", "drift")

    @property
    def sized(self) -> bool:
        """Whether it has sizes of which the smallest that matters can be looked for."""
        return self.high > self.low


#: Why sensors cannot show some faults, or show them late, and what outside of the controller does.
SHIFTED, BEHIND = "every reading is that of a sound arm elsewhere", "nothing measures the links"
SHORTED = "it brakes its joint, as something in its way would"
ALIKE = (
    "encoders of motor and link tell one motion: that of an arm within its tolerances that something pushes"
)
ALONE = "the only encoder of the joint tells a motion that a sound arm may have"
WEIGHT = "the joint moves as a payload within the range, or the ends of the tolerances, would move it"
STILL = "an arm that stands repeats the readings of encoders without noise"
BUSY = "nothing is computed meanwhile; the decision falls in the next step"
OUTSIDE: Mapping[str, str] = {
    SHIFTED: "a mark or a reference switch, looked at before each start",
    BEHIND: "an encoder or a switch on the link; a look at gears and belts",
    SHORTED: "the drive's own supervision of its current",
    ALIKE: "a mark or a reference switch; encoders of two kinds, which do not fail alike",
    ALONE: "a second encoder of the joint; a mark or a reference switch",
    WEIGHT: "narrower tolerances and payloads in the robot file; the drive's own supervision",
    STILL: "`input.fresh` of a bus that counts its frames",
    BUSY: "a watchdog of the drives, which takes their power when no command comes",
}


def seen(facts: Facts) -> str:
    """Nothing: the sensors can show it."""
    return ""


def behind(facts: Facts) -> str:
    """Why nobody sees what happens behind the motors."""
    return "" if facts.links else BEHIND


def alike(facts: Facts) -> str:
    """Why nobody sees that encoders of a joint are wrong alike."""
    return ALIKE


def unchecked(facts: Facts) -> str:
    """Why nobody sees that an encoder is wrong by which another one is not checked."""
    return "" if facts.links and facts.motors else ALONE


def weighed(facts: Facts) -> str:
    """Why what is wrong with a drive shows late."""
    return "" if facts.links else WEIGHT


def alone(facts: Facts) -> bool:
    """Whether nothing measures the links."""
    return not facts.links


def braked(facts: Facts) -> bool:
    """Whether an arm has brakes."""
    return facts.brakes


def several(facts: Facts) -> bool:
    """Whether an arm has another joint."""
    return facts.joints > 1


# Sensors --------------------------------------------------------------------------------------------
SENSOR = (
    Fault("jump", "jump", "", "the reading jumps", 1e-3, 3.0, "rad", "signed"),
    Fault("mirrored", "mirrored", "", "the reading has the other sign"),
    Fault("backward", "backward", "", "it counts backwards from where it is"),
    Fault("swapped", "swapped", "", "it is that of another joint", needs=several),
    Fault("stuck", "stuck", "", "it stays as it is"),
    Fault("zero", "zero", "", "it is zero"),
    Fault("scaled up", "scaled", "", "it is too large by a share", 1e-2, 3.0, "1", "more"),
    Fault("scaled down", "scaled", "", "it is so many times too small, less one", 1e-2, 10.0, "1", "less"),
    Fault("loses counts", "slips", "", "its changes are so many times too small, less one", 1e-2, 10.0, "1", "less"),
    Fault("drifts", "drift", "", "its zero drifts", 1e-2, 10.0, "rad/s", "signed"),
    Fault("wrapped", "wrapped", "", "it jumps by a turn of its encoder", 1.0, 1.0, "turns", "signed"),
    Fault("late", "late", "", "it comes late", 2e-3, 0.2, "s", "samples"),
    Fault("silent", "silent", "", "it gives nothing (NaN)"),
    Fault("dropouts", "dropouts", "", "so large a share is missing (NaN)", 0.05, 0.95, "1"),
    Fault("noise", "noise", "", "it has noise of this standard deviation", 1e-3, 1.0, "rad"),
    Fault("glitches", "glitches", "", "every fiftieth value is wild by this", 1e-3, 3.0, "rad", "signed"),
    Fault("coarse", "coarse", "", "it has steps of this size", 1e-3, 1.0, "rad"),
)  # fmt: skip

FRAMES = (
    Fault("frozen", "frozen", "all", "all readings repeat for some time", 2e-3, 1.0, "s"),
    Fault("frozen for ever", "frozen", "all", "all readings repeat for ever", *EVER, slow=lambda facts: STILL),
    Fault("repeats", "repeats", "all", "of each hundred frames so long repeat", 2e-3, 0.08, "s"),
    Fault("frame late", "late", "all", "all readings come late", 2e-3, 0.2, "s", "samples"),
    Fault("frame silent", "silent", "all", "all readings are NaN"),
    Fault("frame dropouts", "dropouts", "all", "so large a share of all readings is missing", 0.05, 0.95, "1"),
    Fault("unmeasured", "unmeasured", "all", "measured = 0 for some time", 2e-3, 1.0, "s"),
    Fault("unmeasured for ever", "unmeasured", "all", "measured = 0 for ever", *EVER),
)  # fmt: skip

# Drives, mechanics ----------------------------------------------------------------------------------
DRIVES = (
    Fault("dead drive", "dead", "one", "a drive gives no torque"),
    Fault("dead drives", "dead", "all", "no drive gives any torque"),
    Fault("drive full on", "full", "one", "a drive gives all it can, to a side", 1.0, 1.0, "", "signed"),
    Fault("reversed drive", "inverted", "one", "a drive pushes the other way"),
    Fault("reversed drives", "inverted", "all", "all drives push the other way"),
    Fault("swapped drives", "exchanged", "one", "inputs of two joints are swapped", needs=several),
    Fault("weak drive", "weak", "one", "its torque is so many times too small, less one", 0.1, 20.0, "1", "less"),
    Fault("strong drive", "weak", "one", "what a drive gives is too large by a share", 0.1, 9.0, "1", "more"),
    Fault("early saturation", "limited", "one", "a drive lacks this share of its torque", 0.05, 0.98, "1", "rest"),
    Fault("held drive", "held", "one", "a drive stays at its last input"),
    Fault("held drives", "held", "all", "all drives stay at their last inputs"),
    Fault("late drive", "delayed", "one", "a drive acts late", 2e-3, 0.2, "s", "samples"),
    Fault("late drives", "delayed", "all", "all drives act late", 2e-3, 0.2, "s", "samples"),
    Fault("biased drive", "biased", "one", "a drive adds a share of its limit", 0.02, 1.0, "1", "signed"),
    Fault("shorted drive", "shorted", "one", "windings are shorted", needs=lambda facts: facts.drive == "voltage",
          hidden=lambda facts: SHORTED),
)  # fmt: skip

MECHANICS = (
    Fault("soft spring", "spring", "one", "a spring is so many times too soft, less one", 0.2, 50.0, "1", "less",
          hidden=behind),
    Fault("broken spring", "spring", "one", "a spring breaks", 1e-5, 1e-5, hidden=behind),
    Fault("wall", "wall", "one", "something stands in the way, so far ahead", 1e-3, 0.5, "rad", "signed"),
    Fault("blocked joint", "blocked", "one", "a joint is held for ever", *EVER),
    Fault("brake alone", "braked", "one", "a brake closes, its drive goes off", *EVER, needs=braked),
    Fault("brakes alone", "braked", "all", "all brakes close, drives go off", *EVER, needs=braked),
    Fault("brake with power", "dragged", "one", "a brake closes, its drive stays on", *EVER, needs=braked),
    Fault("brakes with power", "dragged", "all", "all brakes close, drives stay on", *EVER, needs=braked),
    Fault("short emergency stop", "estop", "all", "drives off, brakes closed for a time", 0.01, 1.0, "s", needs=braked),
    Fault("power lost", "unpowered", "all", "drives off for some time", 0.01, 1.0, "s"),
    Fault("power lost for ever", "unpowered", "all", "drives off for ever", *EVER, slow=weighed),
    Fault("payload lost", "payload", "all", "a payload that is always there is lost", 0.0, 0.0, "kg",
          needs=lambda facts: facts.payload[0] > 0.0),
    Fault("payload beyond", "payload", "all", "a payload beyond the range is grasped", 1.2, 10.0, "of its largest"),
)  # fmt: skip

STARTS = (
    Fault("elsewhere", "elsewhere", "one", "the arm starts elsewhere", 1e-2, 1.5, "rad", "signed", True, alone),
    Fault("wrong home", "homed", "both", "encoders were set to home elsewhere", 1e-2, 1.5, "rad", "signed", True, alone,
          hidden=lambda facts: SHIFTED),
    Fault("starts in motion", "moving", "one", "a joint moves at the start", 0.05, 2.0, "rad/s", "signed", True),
)  # fmt: skip

CLOCK = (
    Fault("wild jitter", "jitter", "all", "the period jitters by this share", 0.35, 0.95, "1"),
    Fault("slow clock", "period", "all", "the period is too long by a share", 0.12, 4.0, "1", "more"),
    Fault("fast clock", "period", "all", "the period is so many times too short, less one", 0.12, 4.0, "1", "less"),
    Fault("overruns", "overrun", "all", "every hundredth step takes so long", 5e-3, 0.3, "s",
          hidden=lambda facts: BUSY),
)  # fmt: skip


def _drives() -> Iterator[Fault]:
    """Faults of drives; where nothing measures the links, what a drive gives is told by the way of its motor alone."""
    for fault in DRIVES:
        yield fault if fault.name == "shorted drive" else replace(fault, slow=weighed)


def _sensors() -> Iterator[Fault]:
    """Faults of sensors, each of the link's encoder, of the motor's, and of both alike."""
    zero = Fault(
        "wrong zero", "offset", "", "the zero is wrong from the start", 1e-3, 3.0, "rad", "signed", True
    )
    sides = {
        "link": lambda facts: facts.links,
        "motor": lambda facts: facts.motors,
        "both": lambda facts: facts.links and facts.motors,
    }
    for fault in (*SENSOR, zero):
        for side, has in sides.items():

            def needs(facts: Facts, has: Any = has, also: Any = fault.needs) -> bool:
                return has(facts) and also(facts)

            hidden = (lambda facts: SHIFTED) if fault is zero else alike if fault.gradual else seen
            hidden = hidden if side == "both" else unchecked if fault.gradual else seen
            yield replace(fault, name=f"{fault.name}, {side}", side=side, needs=needs, hidden=hidden)


#: By what fails.
GROUPS: Mapping[str, tuple[Fault, ...]] = {
    "a joint's sensors": tuple(_sensors()),
    "whole frames": FRAMES,
    "drives": tuple(_drives()),
    "mechanics": MECHANICS,
    "the start": STARTS,
    "the clock": CLOCK,
}
#: By name.
FAULTS: Mapping[str, Fault] = {fault.name: fault for faults in GROUPS.values() for fault in faults}

#: What no controller may stop for.
HARMLESS: Mapping[str, Fault] = {
    fault.name: fault
    for fault in (
        Fault("held and let go", "blocked", "one", "a joint is held and let go", 0.05, 1.0, "s", lasts=6.0),
        Fault("far command", "commanded", "one", "the first command is 2 rad away", 2.0, 2.0, "rad", "signed", True,
              lasts=6.0),
        Fault("hiccup", "hiccup", "all", "nothing is computed for a second", 1.0, 1.0, "s"),
        Fault("jitter", "jitter", "all", "the period jitters by this share", 0.02, 0.3, "1"),
        Fault("payload put down", "payload", "all", "the payload becomes the least of its range", 0.0, 0.0, "kg",
              needs=lambda facts: facts.payload[1] > facts.payload[0]),
    )
}  # fmt: skip

#: Why some of these stop an arm nevertheless.
TRIPS: Mapping[str, str] = {
    "held and let go": "a link held at full speed throws the joint behind it; a position drive that is held may swing "
    "from one end of its torque to the other",
    "hiccup": "drives that go on pushing for a second throw the arm far from its path",
    "jitter": "at full speed, jitter of 15 % and more is noise, of which inputs swing over half of their range",
}

#: Nothing is wrong: so many moves in a run, at full speed.
MOVES = Fault("moves", "none", "all", "nothing is wrong")
MOVES_OF_A_RUN = 10


def fitting(facts: Facts) -> list[Fault]:
    """The faults that an arm may have."""
    return [fault for fault in FAULTS.values() if fault.needs(facts)]


def drawn(
    fault: Fault, facts: Facts, smallest: Mapping[str, float], seed: int, size: float | None = None
) -> dict[str, Any]:
    """Keys of a line for the runner, and the size x; all that is random comes of the seed. `size` states x instead."""
    chance = random.Random(seed)  # not for secrets
    joint, other = chance.randrange(facts.joints), chance.randrange(max(1, facts.joints - 1))
    sign, share, at = chance.choice((-1.0, 1.0)), chance.random(), chance.uniform(EARLIEST, LATEST)
    low = max(fault.low, smallest.get(fault.name, 0.0))
    x = size if size is not None else low * (fault.high / low) ** share if fault.sized else fault.high
    magnitude = FORMS[fault.form](x, sign, facts.period)
    if fault.kind == "payload":
        magnitude = (
            facts.payload[0] if fault in HARMLESS.values() else x * max(facts.payload[1], LEAST_PAYLOAD)
        )
    return {
        "kind": fault.kind, "magnitude": magnitude, "joint": -1 if fault.side == "all" else joint,
        "other": other + (other >= joint) if facts.joints > 1 else 0,
        "links": int(fault.side in ("link", "both", "all")), "motors": int(fault.side in ("motor", "both", "all")),
        "at": 0.0 if fault.starts else at, "lasts": fault.lasts, "seed": seed,
        **({"moves": MOVES_OF_A_RUN} if fault is MOVES else {}), "x": x,
    }  # fmt: skip


#: Where a file states no payload, kg: what a payload "beyond its range" is a multiple of.
LEAST_PAYLOAD = 0.2
