"""What couples joints of an MJCF file beside its links: equalities, loops that they close, and tendons."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from xml.etree.ElementTree import Element

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot.rigid_arm import selection
from flexhinf.validation import value_text

#: How couplings and tendons name what they act on.
ENDS = {
    "joint": ("joint1", "joint2"),
    "body": ("body1", "body2"),
    "site": ("site1", "site2"),
    "tendon": ("tendon1", "tendon2"),
}

#: What a tendon runs through or around.
AROUND = ("site", "geom")

#: Attributes by which a tendon acts without an actuator.
ACTS = ("stiffness", "damping", "frictionloss", "armature")

#: So many couplings are named in one message.
NAMED = 4


class Couplings:
    """Equalities and tendons of a file, and which of some joints each of them couples."""

    def __init__(self, root: Element, joints: Collection[str]) -> None:
        self.joints = joints
        self.equalities = [
            element
            for group in root.findall("equality")
            for element in group
            if element.get("active", "true") != "false"
        ]
        self.tendons = {str(part.get("name")): part for group in root.findall("tendon") for part in group}
        self.pulled = {str(part.get("tendon")) for part in root.findall("actuator/*") if part.get("tendon")}
        self.defaults = [part for part in root.iter("tendon") if len(part) == 0]
        by_hand = any(part.get("autolimits") == "false" for part in root.iter("compiler"))
        self._limited = ("true",) if by_hand else ("true", "auto")
        self._chains: dict[str, tuple[str, ...]] = {"body world": ()}
        for world in root.findall("worldbody"):
            self._chains |= _chains(world, joints)

    def of(self, element: Element) -> list[str]:
        """Joints that an equality or a tendon couples, in the order of the file: those between its ends, which form a
        loop with it."""
        ends = {word: [name for key in keys if (name := element.get(key))] for word, keys in ENDS.items()}
        if element.tag == "fixed":
            return self._ordered({part.get("joint") for part in element})
        if ends["joint"]:
            return self._ordered(ends["joint"])
        if {*ends["tendon"]} - {*self.tendons}:
            return [*self.joints]
        if ends["tendon"]:
            return self._ordered({name for end in ends["tendon"] for name in self.of(self.tendons[end])})
        if element.tag == "spatial":
            ends |= {tag: [str(part.get(tag)) for part in element if part.tag == tag] for tag in AROUND}
        places = [f"{word} {name}" for word in ("body", *AROUND) for name in ends.get(word, ())]
        if not places:
            return [*self.joints]
        chains = [{*self._chains.get(place, ())} for place in places] + [set[str]()] * (len(places) == 1)
        return self._ordered(set[str].union(*chains) - set[str].intersection(*chains))

    def acts(self, tendon: Element) -> str:
        """The attribute by which a tendon acts without an actuator; "" for none."""
        acting = [key for key in ACTS if any(number_of(word) != 0.0 for word in tendon.get(key, "").split())]
        if tendon.get("range") and tendon.get("limited", "auto") in self._limited:
            acting.append("range")
        return (acting or [""])[0]

    def held(self) -> dict[str, list[str]]:
        """Joints in loops, and those that tendons couple so that none of them moves alone, by why."""
        closing = [part for part in self.equalities if part.tag != "joint" and self.of(part)]
        loops = {name for part in closing for name in self.of(part)}
        always = any(self.acts(part) for part in self.defaults)
        spanning = [
            part
            for name, part in self.tendons.items()
            if always or self.acts(part) or (name in self.pulled and part.tag == "spatial")
        ]
        pulled = {name for part in spanning for name in self.of(part)} - loops
        return {
            f"<equality> {'; '.join(_named(closing))} closes loops with them": self._ordered(loops),
            f"tendons pull them: {'; '.join(_named(spanning))}": self._ordered(pulled),
        }

    def _ordered(self, names: Collection[str | None]) -> list[str]:
        return [name for name in self.joints if name in names]


def check_couplings(root: Element, moving: Sequence[str]) -> None:
    """Refuse what couples moving joints: equalities all at once, then the first tendon that acts."""
    couplings = Couplings(root, moving)
    found = [(element, names) for element in couplings.equalities if (names := couplings.of(element))]
    coupled = {name for _, names in found for name in names}
    free = [name for name in moving if name not in coupled]
    without = "active='false' in each of them: the robot without it"
    refuse_if(
        found,
        f"<equality> {'; '.join(_named([element for element, _ in found]))} couples what moves.",
        f"expected a tree of independent joints, got coupled ones: {value_text(', '.join(sorted(coupled)), 200)}",
        f"{selection(free, moving)}; or {without}" if free else without,
    )
    acting = [part for part in couplings.tendons.values() if couplings.of(part)]
    for element in [*acting, *(couplings.defaults if acting else [])]:
        if key := couplings.acts(element):
            own = [element] if element.tag != "tendon" else acting
            still = {name for part in own for name in couplings.of(part)}
            free = [name for name in moving if name not in still]
            raise InvalidInput(
                f"a tendon has {key}: {'; '.join(_named(own))}.",
                f"expected joints that are coupled by links alone, got {key}={element.get(key)!r}"
                + (" of the default of tendons" if element.tag == "tendon" else ""),
                (f"{selection(free, moving)}; or " if free else "") + f"the tendon without {key}",
            )


def number_of(text: str) -> float:
    """A number of an attribute; NaN where it is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _named(elements: Sequence[Element]) -> Iterator[str]:
    for element in elements[:NAMED]:
        parts = [str(element.get(key)) for keys in ENDS.values() for key in keys if element.get(key)]
        name = value_text(", ".join(parts) or element.get("name", ""), 120)
        yield f"{element.tag} of {name}" if parts else name
    if len(elements) > NAMED:
        yield f"and {len(elements) - NAMED} more"


def _chains(
    element: Element, joints: Collection[str], above: tuple[str, ...] = ()
) -> dict[str, tuple[str, ...]]:
    """Of each body, site and geom of an element the joints between it and the world."""
    parts = list(element)
    for part in parts:  # which grow: what stands in a frame belongs to its body
        parts += list(part) if part.tag == "frame" else []
    above += tuple(
        str(part.get("name")) for part in parts if part.tag == "joint" and part.get("name") in joints
    )
    found = {f"{element.tag} {element.get('name')}": above, "body world": ()}
    for part in parts:
        if part.tag in AROUND:
            found[f"{part.tag} {part.get('name')}"] = above
        elif part.tag == "body":
            found |= _chains(part, joints, above)
    return found
