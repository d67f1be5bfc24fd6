"""A departure with which a law describes a record."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fitting.estimation.result import Parameter


@dataclass(frozen=True)
class Scale:
    """The scanned frequency or wavelength of a departure."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class FittedDeparture:
    name: str
    # standard deviations of a normal variable that is as unlikely, the number of departures that were tried taken into
    # account
    sigmas: float
    parameter: str  # symbol of its size
    value: float
    stderr: float
    unit: str
    text: str  # what it says of the rig
    explained: float  # share of the misfit beyond the noise that it explains
    law: int | str  # the law that describes the record together with it
    parameters: Mapping[str, Parameter]  # of that law
    scale: Scale | None = None
    refitted: bool = True  # no other departure is reported

    def as_json(self) -> dict[str, Any]:
        """Return the document's form."""
        row: dict[str, Any] = {
            "name": self.name,
            "sigmas": self.sigmas,
            "parameter": self.parameter,
            "value": self.value,
            "stderr": self.stderr,
            "unit": self.unit,
            "text": self.text,
            "explained": self.explained,
            "refitted": self.refitted,
            "law": self.law,
            "parameters": {name: item.as_json() for name, item in self.parameters.items()},
        }
        if self.scale is not None:
            row["scale"] = vars(self.scale)
        return row
