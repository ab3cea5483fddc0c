"""Arguments of which a controller is made again."""

from __future__ import annotations

from typing import Any

from flexhinf.loop.controller.laws import NAMED


def options_of(controller: Any) -> dict[str, Any]:
    """Options of a controller by name, of which another one is made."""
    mode, limits, command = controller.mode, controller.limits, controller.command_limits
    return {
        "moving": mode.moving, "start": mode.start, "blend_time": controller.blend_time_option, "latency": mode.latency,
        "before_first": controller.first_input.option, "saturation": (limits.lower, limits.upper),
        **({"input_rate": limits.rate} if mode.limits_input_rate else {}),
        **({"command_range": (command.lower, command.upper), "command_rate": command.rate}
           if mode.limits_command else {}),
        **({"integral_dead_zone": controller.integral_dead_zone} if mode.has_dead_zone else {}),
        **({"offset_time": controller.offset_time} if mode.has_offset else {}),
        **{name: each for name in NAMED if (each := getattr(controller, name))},
        **({"measurement_limits": controller.measurement_limits} if mode.checks_measurements else {}),
        **({"windup": controller.windup} if mode.bounds_windup or controller._windup_option is not None else {}),
        **({"compensate": tuple(controller.estimated[k] for k in mode.compensated)} if mode.compensated else {}),
    }  # fmt: skip
