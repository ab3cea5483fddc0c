"""Campaign of a design: many robots of its tolerances, with its controller."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from flexhinf.campaign import in_processes, on_device, run_in_memory
from flexhinf.designs.campaign_options import CampaignOptions
from flexhinf.designs.deployed_run import DesignCampaign, PoseCampaign
from flexhinf.designs.fields import law_of
from flexhinf.designs.request import DesignRequest
from flexhinf.designs.specification import Specification
from flexhinf.designs.workspace.campaign import WorkspaceCampaign
from flexhinf.robot import Robot
from flexhinf.validation import unknown_name

if TYPE_CHECKING:
    import xarray as xr

    from flexhinf.codegen.gpu import Device


def campaign_of(design: DesignRequest, o: CampaignOptions) -> DesignCampaign[Any]:
    """The campaign of any design with these options; InvalidInput as of its kind."""
    kind = WorkspaceCampaign if law_of(design.specification).any_pose else PoseCampaign
    return kind.of(design, o)


def campaign_in_memory(
    robot: Robot,
    s: Specification,
    loop: Any,
    samples: int,
    workers: int = 0,
    device: Device = "cpu",
    **options: Any,
) -> xr.Dataset:
    """The runs of a campaign of a design, as `flexhinf.run_campaign` returns them; options as of `CampaignOptions`.

    Raises `InvalidInput` before any work for what does not fit.
    """
    if unknown := [name for name in options if name not in CampaignOptions.__dataclass_fields__]:
        known = [*CampaignOptions.__dataclass_fields__]
        raise unknown_name(f"A campaign of a design has no option {unknown[0]!r}.", unknown[0], known)
    request = campaign_of(
        DesignRequest(robot, s, robot.name),
        CampaignOptions(samples=samples, **options),
    )
    designed = request.law_of(loop)
    run = request.campaign(replace(designed, length=request.options.duration or designed.length))
    run.check_device(device)
    return run_in_memory(run, in_processes(workers, device=device) if workers else on_device(device))
