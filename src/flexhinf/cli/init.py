"""``flexhinf init``: a robot file to begin with."""

from __future__ import annotations

from pathlib import Path

import typer

from flexhinf.cli.arguments import refuse_existing, with_options
from flexhinf.cli.messages import note, options
from flexhinf.errors import refuse_if
from flexhinf.files import write_file
from flexhinf.validation import checked_path, value_text


@with_options(lambda: (options.InitOptions, ()))
def init(context: typer.Context, o: options.InitOptions) -> None:
    """Write a robot file for a URDF or an MJCF file, or a template.

    Every joint with a motor is in it by name, at home in the middle of its range.
    Grippers and joints that follow others are locked. Friction, gears and rotors
    that the file states are taken. What nobody states (no such file has a
    stiffness) is estimated from masses and limits, with a wide tolerance, and says
    so in its source. Links with an inertia that no body has get the nearest one.

    Then: flexhinf check arm.toml, and flexhinf design arm.toml.
    """
    from flexhinf.robot.drive_text import loop_options
    from flexhinf.robot.drives import TORQUE
    from flexhinf.robot.init_file import branches_text, description_of, drive_of, gears_named, robot_file_text
    from flexhinf.robot.template import template_text

    refuse_if(
        bool(o.source) == bool(o.joints),
        "There is nothing to begin with." if not o.source else "A template has no URDF.",
        f"expected a URDF or MJCF file, or --joints, got {value_text(o.source)} and --joints {o.joints}",
        "flexhinf init arm.urdf, or flexhinf init --joints 3",
    )
    refuse_if(
        o.joints and (o.move or o.gear),
        "A template has no joints to choose.",
        f"got {'--move ' + ', '.join(o.move) if o.move else '--gear ' + ', '.join(o.gear)}",
        "leave it out" + ("" if o.move else "; gear = … in [[joint]] of the file that is written"),
    )
    path = checked_path("The description", o.source) if o.source else None
    out = o.out or Path("my-arm.toml" if path is None else f"{path.stem}.toml")
    refuse_if(
        out.suffix != ".toml",
        "A robot file has another name.",
        f"expected a name that ends in .toml, got {value_text(str(out))}",
        f"--out {out.with_suffix('.toml').name}",
    )
    refuse_existing(out, o.force)
    changes: list[str] = []
    drive = o.drive or TORQUE.name
    if path is None:
        text = template_text(o.joints, drive)
    else:
        found = description_of(path, o.move)
        arm = found.arm()
        changes = [*found.changes, *arm.repeated]
        drive, gears = drive_of(arm, o.drive), gears_named(arm, o.gear)
        rigid = too_fast(out, robot_file_text(found, arm, out, drive, (), gears))
        rigid = tuple(name for name in rigid if name not in gears)
        text = robot_file_text(found, arm, out, drive, rigid, gears)
        if rigid:
            names = ", ".join(map(repr, rigid))
            changes.append(
                f"{names} rigid: as estimated the springs vibrate faster than samples of 1 ms show"
            )
        own = ["--drive", o.drive] if o.drive else []
        own += [word for gear in o.gear for word in ("--gear", gear)]
        again = ["--force", *own, *(["--out", str(o.out)] if o.out else [])]
        changes += filter(None, [branches_text(arm, path, again)])
    out.parent.mkdir(parents=True, exist_ok=True)
    write_file(out, "robot file", lambda name: Path(name).write_text(text, encoding="utf-8"))
    for change in changes:
        note(change)
    typer.echo(
        f"robot file: {out}\ncheck:  flexhinf check {out}\ndesign: flexhinf design {out}{loop_options(drive)}"
    )


def too_fast(out: Path, text: str) -> tuple[str, ...]:
    """Joints of a robot file, by its text, whose springs vibrate faster than samples of a design's default period show;
    none of a file that is no robot yet, which `check` says."""
    from flexhinf.designs import Specification
    from flexhinf.designs.advice import unseen
    from flexhinf.errors import FlexhinfError
    from flexhinf.robot import load_robot
    from flexhinf.robot.parts import file_warnings

    draft = out.with_name(f".{out.stem}-draft.toml")
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        draft.write_text(text, encoding="utf-8")
        with file_warnings():
            return unseen(load_robot(draft), Specification().period)
    except (FlexhinfError, OSError):
        return ()
    finally:
        draft.unlink(missing_ok=True)
