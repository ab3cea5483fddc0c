"""An FMU in fmpy, of either version, that is set, read and stepped by names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

#: Sampling period of exported models, s.
PERIOD = 1e-3


class Fmu:
    """An instance of a file, which unpacks in a folder of its own; it is initialised at time 0 if it is `begun`."""

    def __init__(self, path: Path, folder: Path, begun: bool = True) -> None:
        import fmpy

        self.about = fmpy.read_model_description(str(path))
        self.at = {variable.name: variable.valueReference for variable in self.about.modelVariables}
        self.old = self.about.fmiVersion == "2.0"
        self.model: Any = fmpy.instantiate_fmu(
            fmpy.extract(str(path), unzipdir=str(folder)), self.about, "CoSimulation"
        )
        self.enter()
        if begun:
            self.run()

    def enter(self) -> None:
        """Into its initialisation, where starts and parameters are set."""
        if self.old:
            self.model.setupExperiment(startTime=0.0)
        self.model.enterInitializationMode()

    def run(self) -> None:
        """Out of its initialisation."""
        self.model.exitInitializationMode()

    def again(self, **values: float) -> None:
        """From the beginning, with these starts and parameters."""
        self.model.reset()
        self.set(**values)
        self.enter()
        self.run()

    def set(self, values: dict[str, float] | None = None, **named: float) -> None:
        """By names, whose dots may be written as two underscores."""
        given = {**(values or {}), **{name.replace("__", "."): value for name, value in named.items()}}
        write = self.model.setReal if self.old else self.model.setFloat64
        write([self.at[name] for name in given], list(given.values()))

    def get(self, *names: str) -> list[float]:
        read = self.model.getReal if self.old else self.model.getFloat64
        return read([self.at[name] for name in names])

    def step(self, k: int, size: float = PERIOD) -> None:
        """From sample k on."""
        self.model.doStep(currentCommunicationPoint=PERIOD * k, communicationStepSize=size)

    def end(self) -> None:
        self.model.terminate()
        self.model.freeInstance()

    def of(self, causality: str) -> list[str]:
        """Names of the real variables of a causality."""
        kinds = ("Real", "Float64")
        return [v.name for v in self.about.modelVariables if v.causality == causality and v.type in kinds]
