"""A departure that was found in a record."""

from dataclasses import dataclass
from typing import Any

from stickslip.units import Measured


@dataclass(frozen=True)
class Scale:
    """What else a departure depends on, as scanned: a frequency, a wavelength."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class FoundDeparture:
    """One departure with its size.

    Attributes
    ----------
    name : str
    sigmas : float
        Standard deviations of a normal variable that is as unlikely, the number of departures and scales that were
        tried taken into account.
    parameter : str
        Symbol of its size.
    value, stderr : float
    unit : str
    text : str
        What it says of the rig.
    scale : Scale or None
    gain : float
        By how much the cost falls with it.
    explained : float
        Share of the misfit beyond the noise that it explains.
    refitted : bool
        Whether value and stderr come from a fit with it.
    law : int or None
        The law that describes the record together with it, where one does.
    """

    name: str
    sigmas: float
    parameter: str
    value: float
    stderr: float
    unit: str
    text: str
    scale: Scale | None = None
    gain: float = 0.0
    explained: float = 0.0
    refitted: bool = False
    law: int | None = None

    @property
    def size(self) -> Measured:
        """Value and standard error."""
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
