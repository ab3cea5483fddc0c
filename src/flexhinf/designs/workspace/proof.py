"""What is proved of a controller for a workspace: which errors of masses and springs its loop tolerates at rest.

Everything is of pairs of a link and a motor: `flexhinf.modal.popov` has the inequality, docs/theorem.md the theorem.
Without such a proof `flexhinf.modal.stability` says for which pairs the loop without errors is proved to be stable.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from flexhinf.certify.checker.arm import CheckedArm, arm_claim, check_arm
from flexhinf.certify.checker.moves import CheckedMoves, MovesClaim, check_moves, moves_claim
from flexhinf.certify.checker.pair_claim import PairClaim, pair_claim
from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs
from flexhinf.copies import shared_out
from flexhinf.designs.specification import Specification
from flexhinf.designs.workspace.everywhere import Everywhere, everywhere, file_errors
from flexhinf.designs.workspace.masses import LargestMasses, StatedErrors, largest_masses
from flexhinf.designs.workspace.moves import ProvedMoves, proved_moves
from flexhinf.designs.workspace.pair_proof import Numbers, largest_certificate
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import refuse_if
from flexhinf.estimation import ModalFilter
from flexhinf.modal import ProvedRange, proved_range
from flexhinf.modal.law import modes
from flexhinf.modal.multipliers import PopovTolerance, popov_tolerance
from flexhinf.modal.pair_errors import EXACT, NONE, SYMMETRIC, Errors, Sector
from flexhinf.modal.sampled_pairs import Motors, SampledPairs
from flexhinf.modal.unstable import UnstableError, smallest_unstable
from flexhinf.numerals import number
from flexhinf.robot import Robot
from flexhinf.robot.file_keys import is_dict

#: λ at which a report computes a tolerance.
REPORTED = 12

#: Version of a proof.json; the entries of one.
VERSION = 7
ENTRIES = (
    "version", "kind", "robot", "text", "controller", "hypotheses", "largest", "proved", "stated", "computed",
    "unstable", "unstable_springs", "stable", "latency", "unknown_delay", "estimator", "weights", "random_torques",
    "pairs", "everywhere", "arm", "moves", "moving", "speeds",
)  # fmt: skip

#: How a checker has its intervals checked.
_AT_ONCE = partial(shared_out, compiles=False)

#: By what share numbers of motors differ that are still alike, and by what share doubles may round them.
ALIKE, ROUNDED = 1e-9, 1e-12

#: Poses, and their seed, at which it is judged whether all vibrations are in a range that other poses have chosen.
RANGE_POSES, RANGE_SEED = 2000, 5


@dataclass(frozen=True, eq=False)
class CertifiedErrors:
    """The errors that a search has found, and whether they hold the file's."""

    stated: StatedErrors
    tolerance: PopovTolerance
    numbers: Numbers | None

    @cached_property
    def checked(self) -> CheckedPairs | None:
        """What the checker says, of all intervals once more."""
        found = None if self.numbers is None else check_pairs(pair_claim(self.numbers), _AT_ONCE)
        return found if isinstance(found, CheckedPairs) else None

    @property
    def is_stated(self) -> bool:
        """Whether all that the file states is within what is proved, with what stands beside its tolerances."""
        return self.checked is not None and self.stated.errors.within(proved_errors(self.checked))

    @property
    def are_tolerances_proved(self) -> bool:
        """The same of masses, payloads and springs alone."""
        own = self.stated.of_tolerances.errors
        return self.checked is not None and own.within(proved_errors(self.checked))


def proved_errors(checked: CheckedPairs | None) -> Errors:
    """The errors of a certificate; none without one."""
    if checked is None:
        return NONE
    masses, springs = Sector(checked.lower, checked.upper), Sector(checked.softer, checked.stiffer)
    slope = Sector(checked.falling, checked.holding_up)
    return Errors(masses, springs, slope, checked.spring_damping, checked.any_motion)


class WorkspaceProof(NamedTuple):
    """The errors that are proved to be tolerated, and those of masses that are found to destabilise."""

    setup: WorkspaceSetup
    stated: StatedErrors  # what the file's tolerances need
    tolerance: PopovTolerance  # what is tolerated beside errors of the kinds that are proved, as computed
    numbers: Numbers | None  # the certificate of pairs; None where no errors are proved to be tolerated
    checked: CheckedPairs | None  # what the checker says of it
    unstable: UnstableError  # the smallest error that is found to destabilise
    stable: ProvedRange  # pairs that are proved to be stable without errors
    largest: LargestMasses | None = None  # for which the proof would still hold; None without proved errors
    unstable_springs: UnstableError | None = None  # the same of the stiffness; None where that is exact
    everywhere: Everywhere | None = None  # what is shown at every pose; None where poses are sampled
    moves: ProvedMoves | None = None  # how fast poses may change; None where that is not proved

    @property
    def is_proved(self) -> bool:
        """Whether anything is proved."""
        return self.checked is not None or self.stable.high > self.stable.low

    @property
    def is_stated(self) -> bool:
        """Whether the masses, payloads and springs of the file's tolerances are within what is proved."""
        return self.checked is not None and self.stated.of_tolerances.errors.within(self.errors)

    @property
    def has_slope(self) -> bool:
        """Whether gravity's slope is within what is proved; also where there is none."""
        return self.stated.errors.slope == EXACT or (
            self.checked is not None and self.stated.errors.slope.upper <= self.errors.slope.upper
        )

    @property
    def unlike_motors(self) -> dict[str, float]:
        """By what share each number of motors differs from joint to joint, as of `motors_apart`; nothing where the
        proof is of motors as unlike.

        Otherwise the theorem takes motors as alike. The law makes unlike ones so for slow vibrations only: `ModalLaw`.
        """
        if self.checked is None or self.setup.law.joints.inner:
            return motors_apart(self.setup)
        if any(own > held for own, held in zip(motor_sectors(self.setup), self.checked.motors)):
            return motors_apart(self.setup)
        return {}

    @property
    def without(self) -> list[str]:
        """What the robot has, and the proof has not: unlike motors, gravity's slope, damping of springs."""
        differ = [
            f"{name} differs by {number(100.0 * apart, 2)} %" if np.isfinite(apart) else f"{name} differs"
            for name, apart in self.unlike_motors.items()
        ]
        kinds = (
            (f"unlike motors (their {', '.join(differ)})", bool(differ)),
            ("gravity's slope", not self.has_slope),
            ("damping of springs", self.stated.errors.damping > self.errors.damping),
        )
        return [name for name, is_left_out in kinds if is_left_out]

    @property
    def range(self) -> tuple[float, float]:
        """The λ of which something is proved, 1/s²."""
        known = self.stable if self.checked is None else self.checked
        return known.low, known.high

    @property
    def poses_inside(self) -> int:
        """How many of `RANGE_POSES` have all their vibrations there."""
        return RANGE_POSES - poses_outside(self.setup, *self.range)

    @property
    def errors(self) -> Errors:
        """What is proved to be tolerated; nothing where no error is."""
        return proved_errors(self.checked)

    @property
    def covers_file(self) -> bool:
        """Whether the proof is of the robot, and of all that the file states of masses and springs; of something, where
        it states nothing."""
        held = self.is_stated if self.stated.of_tolerances.errors.largest else self.is_proved
        return held and not self.without


def sampled_pairs(setup: WorkspaceSetup) -> SampledPairs:
    """The pairs of a setup, with its latency, its estimator, its unknown delay, if that is at most a sample, and its
    unlike motors, where a proof may hold these."""
    s = setup.specification
    delay = float(s.unknown_samples) if s.unknown_samples <= 1 else 0.0
    pairs = SampledPairs(setup.gains, s.known_latency, modal_filter(setup), delay)
    if s.unknown_samples or s.known_latency > 1 or setup.law.joints.inner or not motors_apart(setup):
        return pairs
    return replace(pairs, motors=motor_sectors(setup))


def motor_sectors(setup: WorkspaceSetup) -> Motors:
    """How far motors are from alike, in sectors that hold all joints, of torque drives."""
    joints, gains, apart = setup.law.joints, setup.gains, motors_apart(setup)
    twists = joints.stiffness / joints.motor_inertia / gains.motor - 1.0
    speeds = joints.motor_damping / joints.motor_inertia - gains.damping
    sectors = [
        max(0.0, float(end)) * (1.0 + ALIKE) + ROUNDED * scale if name in apart else 0.0
        for name, own, scale in (("K/J", twists, 1.0), ("B/J", speeds, gains.damping))
        for end in (-own.min(), own.max())
    ]
    return Motors(*sectors)


def motors_apart(setup: WorkspaceSetup) -> dict[str, float]:
    """By what share the largest of some numbers of motors exceeds the smallest one, where they differ from joint to
    joint: the accelerations per twist K/J, with the share of the load that moves a motor, and per speed B/J, and the
    stiffness of a drive over J. It is infinite where the smallest is 0."""
    joints = setup.law.joints
    numbers = {
        "K/J": joints.load_share * joints.stiffness,
        "B/J": joints.motor_damping,
        "drive stiffness/J": joints.drive_stiffness,
    }
    apart = dict[str, float]()
    for name, one in numbers.items():
        low, high = (float(end) for end in np.quantile(one / joints.motor_inertia, (0.0, 1.0)))
        if high - low > ALIKE * max(high, -low):
            apart[name] = high / low - 1.0 if low > 0.0 else float("inf")
    return apart


def check_pairs_of(setup: WorkspaceSetup) -> None:
    """Refuse a law whose loop does not fall into pairs of a link and a motor."""
    refuse_if(
        setup.pairs is None,
        f"No proof holds the law {setup.specification.law}.",
        "expected gains that are functions of M(q) alone, so that the loop falls into pairs of a link and a motor",
        "law='modal'; or law='nl-hinf', estimator='auto', preset='damped' and pose='home', of a robot of one joint",
    )


def check_unknown_delay(s: Specification) -> None:
    """Refuse an unknown delay that no proof holds."""
    more = s.known_latency + s.unknown_samples - 1
    refuse_if(
        s.unknown_samples > 1,
        "No proof holds this unknown delay.",
        f"expected at most one sample, {1e3 * s.period:g} ms, got {1e3 * s.unknown_delay:g} ms",
        f"unknown_delay='{1e3 * s.period:g}ms' beside latency={more}, of which the estimator knows",
    )


@lru_cache(8)
def poses_outside(setup: WorkspaceSetup, low: float, high: float) -> int:
    """At how many of `RANGE_POSES` the model has a vibration outside of a range of λ, 1/s²."""
    poses = setup.workspace.sample(RANGE_POSES, RANGE_SEED)
    links = modes(setup.law.plant, poses, setup.law.joints.stiffness)
    return int(((links < low) | (links > high)).any(axis=1).sum())


def computed_tolerance(setup: WorkspaceSetup) -> PopovTolerance:
    """Errors of masses, of either sign, that all pairs tolerate with latency and filter; computed at some λ."""
    return popov_tolerance(sampled_pairs(setup), SYMMETRIC, REPORTED)


def proved_stability(setup: WorkspaceSetup) -> ProvedRange:
    """Pairs that are proved to be stable without errors of the model."""
    return proved_range(setup.gains, np.inf, setup.specification.known_latency, modal_filter(setup))


def modal_filter(setup: WorkspaceSetup) -> ModalFilter | None:
    """The estimator that pairs have; None where the true state is fed back."""
    return setup.filter if isinstance(setup.filter, ModalFilter) else None


def prove_workspace(
    setup: WorkspaceSetup,
    progress: Callable[[str], None] = lambda text: None,
    loaded: Robot | None = None,
) -> WorkspaceProof:
    """The proof of symmetric errors of masses, beside the file's errors of springs; where these do not hold the file's,
    of masses in its proportion, or of all that it states; where nothing is proved, of masses alone. Gravity's slope and
    damped springs are in it where the file's errors are proved beside them. With unlike motors it is of all that the
    file states; where nothing is proved so, as if motors were alike.

    `loaded` is the robot with a payload, of which the largest is sought; the setup's own, where it has one.
    """
    check_pairs_of(setup)
    check_unknown_delay(setup.specification)
    pairs, stated = sampled_pairs(setup), file_errors(setup)
    kept = None
    if pairs.motors is not None:
        kept = _largest_proof(pairs, stated, progress)
    if kept is None or kept.checked is None:
        kept = _largest_proof(pairs.alike, stated, progress)
    return with_others(setup, kept, progress, loaded)


def _largest_proof(
    pairs: SampledPairs, stated: StatedErrors, progress: Callable[[str], None]
) -> CertifiedErrors:
    """The proof of what is stated, or of what is left of it in turn."""
    kept = None
    for one in stated.variants:
        found = _proved(pairs, one, progress)
        if one.errors.any_motion and not found.are_tolerances_proved:
            continue
        if (
            kept is None
            or kept.checked is None
            or (found.are_tolerances_proved and not kept.are_tolerances_proved)
        ):
            kept = CertifiedErrors(stated, found.tolerance, found.numbers)
        if kept.are_tolerances_proved:
            break
    assert kept is not None
    return kept


def _proved(pairs: SampledPairs, stated: StatedErrors, progress: Callable[[str], None]) -> CertifiedErrors:
    """The proof of what is stated, as of `prove_workspace`."""
    whole, beside = stated.parts
    if pairs.motors is not None:
        shape = whole if whole.largest else SYMMETRIC
        found = largest_certificate(pairs, shape, progress, beside, whole=whole.largest > 0.0)
        return CertifiedErrors(stated, *found)
    masses, springs = Errors(stated.errors.masses), stated.errors._replace(masses=EXACT)
    shapes = [(SYMMETRIC, springs)]
    if min(masses.masses) < max(masses.masses):
        shapes.append((masses, springs))
    if max(stated.errors.springs) > 0.0:
        shapes.append((whole, beside))
    kept = None
    for shape, fixed in shapes:
        found = largest_certificate(pairs, shape, progress, fixed, whole=max(shape.springs) > 0.0)
        one = CertifiedErrors(stated, *found)
        kept = one if kept is None or one.is_stated or kept.checked is None else kept
        if kept.is_stated:
            break
    assert kept is not None
    if max(stated.errors.springs) > 0.0 and kept.checked is None:
        kept = CertifiedErrors(stated, *largest_certificate(pairs, SYMMETRIC, progress))
    return kept


def with_others(
    setup: WorkspaceSetup,
    found: CertifiedErrors,
    progress: Callable[[str], None] = lambda text: None,
    loaded: Robot | None = None,
) -> WorkspaceProof:
    """The proof with what stands beside the errors that were found; parameters as of `prove_workspace`."""
    progress("smallest error that destabilises")
    pairs, several, springs = sampled_pairs(setup).alike, len(setup.joints) > 1, found.stated.errors.springs
    pairs = pairs.late_by(pairs.delay)
    unstable = smallest_unstable(pairs, mixed=several)
    proof = WorkspaceProof(
        setup, found.stated, found.tolerance, found.numbers, found.checked, unstable, proved_stability(setup)
    )
    if springs != EXACT:
        proof = proof._replace(unstable_springs=smallest_unstable(pairs, several, of_springs=True))
    if proof.checked is None or proof.numbers is None:
        return proof
    masses, ends = proof.errors.masses, (proof.checked.low, proof.checked.high)
    poses = everywhere(setup, masses, ends, found.stated.errors.masses)
    progress("speed of moves")
    return proof._replace(
        largest=largest_masses(setup, masses, loaded or setup.true.robot),
        everywhere=poses,
        moves=proved_moves(setup, pairs, proof.numbers, poses and poses.arm)
        if several and not pairs.delay
        else None,
    )


class PairVerdict(NamedTuple):
    """What the checker says of the certificate of pairs in a proof.json."""

    claim: PairClaim | None = None  # None where the file has none
    checked: CheckedPairs | None = None  # None where the check fails
    failed: tuple[float, float] | None = None  # λ of the interval in which it does, 1/s²
    beyond: str = ""  # what the file says is proved beyond what the check finds
    arm: CheckedArm | None = None  # what holds at every pose; None where the file says nothing of it
    moves: tuple[MovesClaim, CheckedMoves] | None = (
        None  # how fast poses may change; None where it says nothing
    )

    @property
    def is_proved(self) -> bool:
        """Whether the pairs are proved, and the file says no more than that."""
        return self.checked is not None and not self.beyond


def stored_proof(path: Path) -> Mapping[str, Any] | None:
    """The numbers of a proof.json; None of any other file."""
    try:
        numbers = cast("object", json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, RecursionError):
        return None
    return numbers if is_dict(numbers) and numbers.get("kind") == "workspace" else None


def of_controller(estimates: bool) -> str:
    """Of which controller everything is proved, with an estimator or without, and while what holds."""
    own = "its law with its estimator" if estimates else "its law"
    return (
        f"the controller as saved, {own}, while no bit of its status is set, no input is at its limit and no "
        "measurement is refused"
    )


def pair_verdict(numbers: Mapping[str, Any]) -> PairVerdict:
    """The check of the pairs of a proof.json, and of nothing else in it; InvalidInput where they cannot be read."""
    pairs = numbers.get("pairs")
    if not isinstance(pairs, dict):
        return PairVerdict()
    claim = pair_claim(cast("dict[str, Any]", pairs))
    found = check_pairs(claim, _AT_ONCE)
    if isinstance(found, int):
        return PairVerdict(claim, failed=(float(claim.links[found]), float(claim.links[found + 1])))
    beyond = _beyond(numbers.get("proved"), found) or _later(numbers.get("unknown_delay", 0.0), found)
    beyond = beyond or _of_another(numbers, of_controller(claim.seen is not None))
    arm, body, moves = None, None, None
    if is_dict(own := numbers.get("arm")):
        body = arm_claim(own)
        checked = check_arm(body)
        if isinstance(checked, str):
            beyond = beyond or f"that {checked} is within what is proved at every pose"
        else:
            arm, beyond = checked, beyond or _arm_beyond(checked, found)
    if found.any_motion and not _is_single_joint(arm, found):
        beyond = beyond or "that motions may be large"
    stated = numbers.get("everywhere")
    if stated is not None and (arm is None or stated != arm._asdict()):
        beyond = beyond or "of every pose something else"
    if is_dict(own := numbers.get("moves")):
        if found.delay:
            beyond = beyond or "of its moves with an unknown delay something"
        moving = moves_claim(own, claim, body)
        moved = check_moves(moving)
        if isinstance(moved, str):
            beyond = beyond or f"of its moves that {moved} is within what is proved"
        else:
            moves = moving, moved
    stated = numbers.get("moving")
    if stated is not None and (moves is None or stated != moves[1]._asdict()):
        beyond = beyond or "of its moves something else"
    return PairVerdict(claim, found, beyond=beyond, arm=arm, moves=moves)


def _of_another(numbers: Mapping[str, Any], controller: str) -> str:
    """What a file says of another controller than that of its pairs, or under names that no proof has; files before
    version 7 name no controller."""
    unknown = sorted(set(numbers) - set(ENTRIES))
    older = numbers.get("version") in range(1, VERSION) and "controller" not in numbers
    if unknown:
        return f"{unknown[0][:40]!r}"
    return "" if older or numbers.get("controller") == controller else "of its controller something else"


def _is_single_joint(arm: CheckedArm | None, found: CheckedPairs) -> bool:
    """Whether an arm is of one joint whose gravity has the slopes of a certificate of large motions."""
    if arm is None or arm.joints != 1 or arm.slope is None:
        return False
    return arm.slope <= min(found.falling, found.holding_up)


def _arm_beyond(arm: CheckedArm, found: CheckedPairs) -> str:
    """What an arm is shown to have beyond the pairs of its file."""
    if arm.low is not None and arm.high is not None and not found.low <= arm.low < arm.high <= found.high:
        return "of its arm that it has vibrations beyond those of the pairs"
    if arm.lower > found.lower or arm.upper > found.upper:
        return "of its arm that masses have larger errors"
    if max(found.falling, found.holding_up) and (arm.slope or 0.0) > min(found.falling, found.holding_up):
        return "of its arm that gravity has a larger slope"
    return ""


def _later(stated: object, found: CheckedPairs) -> str:
    """What a file says of its design's unknown delay beyond what the check finds."""
    within = not isinstance(stated, bool) and isinstance(stated, (int, float)) and stated <= found.delay
    return "" if within else f"that its loop has an unknown delay of {str(stated)[:40]} samples"


def _beyond(stated: object, found: CheckedPairs) -> str:
    """What a file says is proved beyond what the check finds; empty where there is nothing."""
    if not is_dict(stated):
        return "" if stated is None else "something else"
    for name, value in found._asdict().items():
        own = stated.get(name)
        if isinstance(value, bool):
            if own is value or own is False:
                continue
            return f"{name} = {str(own)[:40]}"
        if isinstance(own, bool) or not isinstance(own, (int, float)):
            return f"{name} = {str(own)[:40]}"
        less = own >= value if name == "low" else own <= value or name == "intervals"
        if not less:
            return f"{name} = {own:g}"
    return ""
