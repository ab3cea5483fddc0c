"""The law of pairs of a link and a motor, `flexhinf.modal.ModalLaw`: its gains are functions of the inertia matrix."""

from __future__ import annotations

from flexhinf.designs.laws.kinds import MODAL, LawKind, register

register(
    LawKind(
        MODAL,
        "H∞ of each pair of a link and a motor, at every pose",
        "flexhinf design",
        usual=True,
        fields=("preset",),
        place=-1,
    )
)
