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
    parameter: str  # symbol of its size; "" for one without a parameter
    value: float  # NaN without a parameter
    stderr: float
    unit: str
    text: str  # what it says of the rig
    scale: Scale | None = None
    gain: float = 0.0  # by how much the cost falls with it
    # share of the misfit beyond the noise that it explains: in the fit with it, else in one linear step
    explained: float = 0.0
    refitted: bool = False  # whether value and stderr come from a fit with it; else from one linear step
    law: int | None = None  # the law that describes the record together with it, where one does

    @property
    def size(self) -> Measured:
        return Measured(self.value, self.stderr)

    def as_json(self) -> dict[str, Any]:
        """Return the document's form; a number that does not exist is None."""
        known = bool(self.parameter)
        row: dict[str, Any] = {
            "name": self.name,
            "sigmas": self.sigmas,
            "parameter": self.parameter or None,
            "value": self.value if known else None,
            "stderr": self.stderr if known else None,
            "unit": self.unit,
            "text": self.text,
            "explained": self.explained,
            "refitted": self.refitted,
            "law": self.law,
        }
        if self.scale is not None:
            row["scale"] = vars(self.scale)
        return row
