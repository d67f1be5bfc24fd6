"""A departure that was found in a record."""

from dataclasses import dataclass
from typing import Any

from stickslip.units import Measured


@dataclass(frozen=True)
class Scale:
    """The scanned frequency or wavelength of a departure."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class FoundDeparture:
    name: str
    # standard deviations of a normal variable that is as unlikely, the number of departures and scales that were tried
    # taken into account
    sigmas: float
    parameter: str  # symbol of its size
    value: float
    stderr: float
    unit: str
    text: str  # what it says of the rig
    scale: Scale | None = None
    gain: float = 0.0  # by how much the cost falls with it
    explained: float = 0.0  # share of the misfit beyond the noise that it explains
    refitted: bool = False  # whether value and stderr come from a fit with it
    law: int | None = None  # the law that describes the record together with it, where one does

    @property
    def size(self) -> Measured:
        return Measured(self.value, self.stderr)

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
        }
        if self.scale is not None:
            row["scale"] = vars(self.scale)
        return row
