"""The folder of a design's campaign: controller and design file, written once, and the campaign made of them again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import tomlkit

from flexhinf.campaign import Campaign, Journal
from flexhinf.design.campaign_options import CampaignOptions
from flexhinf.design.campaign_setup import SIDES, DesignCampaign, DesignPair, fields_text
from flexhinf.design.design_file import DESIGN_FILE, load_design, read_request
from flexhinf.design.design_file_text import request_document
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.laws import DESIGN
from flexhinf.design.limit_cycle import end_limit_cycle
from flexhinf.design.pipeline import step_duration
from flexhinf.design.synthesis.steps import synthesise
from flexhinf.errors import InvalidInput
from flexhinf.files import locked, write_file
from flexhinf.loop import Controller, load_controller
from flexhinf.report import unchanged
from flexhinf.validation import checked_path, read_toml

#: Folder of the design file and the controller inside a campaign's, and their names.
SETUP, CONTROLLER = "setup", "controller"

#: Held while a controller is designed and written.
SETUP_LOCK = ".campaign-setup-lock"

#: What the folder of a comparison may hold.
_OWN = (*SIDES, "index.html")

#: How long a driver waits for another one that designs the controller, s.
PATIENCE = 3600.0


def open_campaign(
    request: DesignCampaign,
    folder: str | Path,
    command: Sequence[str] = (),
    progress: Callable[[str], None] = print,
    designed: tuple[Controller, float] | None = None,
) -> tuple[Campaign, Journal]:
    """The campaign in a folder: designed and written there, or taken up again with the controller that is there.

    `command`: that made it, for its reports.
    `progress`: called with each step's name while the controller is designed.
    `designed`: for a new folder, controller and length of its runs (s) as of `designed_controller`.
    """
    _ = request.stated, request.metrics  # refuses what does not fit
    journal = Journal.read(folder, (SETUP,))
    place = Path(folder).expanduser().absolute()
    if journal is None:
        (place / SETUP).mkdir(parents=True, exist_ok=True)
        with locked(place / SETUP_LOCK, PATIENCE):
            journal = Journal.read(folder, (SETUP,))  # another driver of a job array may have been quicker
            if journal is None:
                return _begun(request, place, command, designed or designed_controller(request, progress))
    journal.refuse_other(request.stated, partly=True)
    campaign = reopened(request, journal)
    journal.refuse_campaign(campaign)
    return campaign, journal


def _begun(
    request: DesignCampaign, place: Path, command: Sequence[str], designed: tuple[Controller, float]
) -> tuple[Campaign, Journal]:
    controller, duration = designed
    duration = duration if request.options.duration is None else request.options.duration
    request.campaign(controller, duration)  # refuses what does not fit before anything is written
    document = request_document(
        request.specification, request.request.source, request.request.elastic, place / SETUP, request.request.payload,
        request.request.robot.links.slides,
    )  # fmt: skip
    text = tomlkit.dumps(document)
    write_file(
        place / SETUP / DESIGN_FILE, "design file", lambda name: Path(name).write_text(text, encoding="utf-8")
    )
    controller.save(place / SETUP / CONTROLLER)
    campaign = request.campaign(load_controller(place / SETUP / CONTROLLER), duration)
    o = request.options
    about = {
        "title": f"Campaign of the robot “{request.request.robot.name}”", "requirements": list(request.requirements),
        "nominal": request.nominal, "options": {**vars(o), "tolerances": [list(one) for one in o.tolerances]},
    }  # fmt: skip
    return campaign, Journal.opened(place, campaign, command, about)


def designed_controller(
    request: DesignCampaign, progress: Callable[[str], None] = print
) -> tuple[Controller, float]:
    """The controller and the length of its runs, s: of a report that nobody changed, or designed now.

    The controller of a report begins where its step does, so for a move it is designed again, to begin where that
    does.
    """
    path, plan = request.file, request.plan
    if (
        plan is None
        and path is not None
        and path.name == DESIGN_FILE
        and unchanged(path.parent, (DESIGN_FILE, CONTROLLER))
    ):
        length = read_toml(path, "design file").get("result", {}).get("duration")
        if isinstance(length, float) and fields_text(load_design(path)[1]) == fields_text(
            request.specification
        ):
            return load_controller(path.parent / CONTROLLER), length
    robot, s = request.request.robot, request.specification
    synthesis = synthesise(robot, s, progress)
    setup = end_limit_cycle(synthesis.setup(robot, s))[0]
    length = step_duration(LawEvaluation(DESIGN, setup), synthesis)
    if plan is None:
        return setup.bumpless_controller, length
    periods = round((plan.duration + length) / s.period)
    return setup.controller(request.ends[0], moving=True), periods * s.period


def reopened(request: DesignCampaign, journal: Journal) -> Campaign:
    """The campaign of a folder, with the controller that is there."""
    controller = load_controller(journal.folder / SETUP / CONTROLLER)
    return request.campaign(controller, float(journal.settings["duration"]))


def stored_campaign(folder: str | Path) -> tuple[Campaign, Journal]:
    """The campaign of a folder as it stands there, for replays: nothing is asked for beside it."""
    journal = Journal.read(folder)
    if journal is None or "options" not in journal.about:
        raise InvalidInput(
            "The folder holds no campaign of a design.",
            f"expected a folder that `flexhinf campaign` wrote, got {folder}",
            "its --out; a campaign from Python replays with Campaign(...).replay(sample)",
        )
    request = stored_request(journal)
    journal.refuse_other(request.stated, partly=True)
    return reopened(request, journal), journal


def stored_request(journal: Journal) -> DesignCampaign:
    """The design and the campaign of a folder."""
    known = CampaignOptions.__dataclass_fields__
    try:
        stored = {name: value for name, value in journal.about["options"].items() if name in known}
        stored["tolerances"] = tuple((str(name), str(spread)) for name, spread in stored["tolerances"])
        options = CampaignOptions(**stored)
    except InvalidInput:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInput(
            "The options of the campaign cannot be read.",
            f"{journal.folder}: {error}",
            "a copy of its manifest",
        ) from error
    return DesignCampaign(read_request(journal.folder / SETUP / DESIGN_FILE), options)


# Two campaigns on the same samples --------------------------------------------------------------------------
def open_pair(
    pair: DesignPair,
    folder: str | Path,
    commands: Sequence[Sequence[str]] = ((), ()),
    progress: Callable[[str], None] = print,
) -> list[tuple[Campaign, Journal]]:
    """The campaigns of both designs in a folder, with runs of the same length: made there, or taken up again.

    `folder`: of the comparison; the campaigns are in its folders `SIDES`.
    `commands`: that make each campaign, for its reports.
    `progress`: called with each step's name while controllers are designed.
    """
    place = checked_path("The comparison's folder", folder).expanduser().absolute()
    _check_folder(place)
    place.mkdir(parents=True, exist_ok=True)
    with locked(place / SETUP_LOCK, PATIENCE):
        designed = _designed(pair, place, progress)
        return [
            open_campaign(one, place / name, command, progress, given)
            for one, name, command, given in zip((pair.a, pair.b), SIDES, commands, designed)
        ]


def _designed(
    pair: DesignPair, place: Path, progress: Callable[[str], None]
) -> list[tuple[Controller, float] | None]:
    """Controllers that are not in the folder yet, with the longer of both steps, or that of the run which is there."""
    sides = [(side, Journal.read(place / name, (SETUP,))) for side, name in zip((pair.a, pair.b), SIDES)]
    for side, journal in sides:
        if journal is not None:  # refused before the other one is designed
            journal.refuse_other(side.stated, partly=True)
    designed = [None if journal else designed_controller(side, progress) for side, journal in sides]
    begun = [float(journal.settings["duration"]) for _, journal in sides if journal]
    duration = begun[0] if begun else float(np.max([one[1] for one in designed if one]))
    return [None if one is None else (one[0], duration) for one in designed]


def _check_folder(place: Path) -> None:
    if place.exists() and not place.is_dir():
        raise InvalidInput(
            "A comparison needs a folder, and there is a file.", f"got {place}", "another name"
        )
    names = [path.name for path in place.iterdir()] if place.is_dir() else []
    if strangers := [name for name in names if name[:1] != "." and name not in _OWN]:
        raise InvalidInput(
            "The folder holds something that is not a comparison of campaigns, and is left alone.",
            f"expected no folder, an empty one, or one with {', '.join(_OWN)}; got {sorted(strangers)[:3]} in {place}",
            "another folder",
        )
