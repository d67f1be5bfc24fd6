"""The assessment of a record: whether a law describes it, and what else is known if none does."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fitting.adequacy.goodness import GoodnessOfFit
from fitting.curve.result import BandExit, MeasuredCurve
from fitting.departures.result import FittedDeparture

ADEQUATE = "adequate"
NONE_OF_SIX = "none of the six"
NOT_OF_SPEED = "not a function of relative speed"
NONE_FITTED = "none of the laws fitted"
NOT_JUDGED = "not judged"


@dataclass(frozen=True, eq=False)
class Adequacy:
    # `ADEQUATE`; `NONE_OF_SIX`: no law, but a curve without a law may; `NOT_OF_SPEED`: not even that; `NONE_FITTED`
    # where not all six laws were fitted; None where nothing could be judged (`fitting.adequacy.goodness`)
    verdict: str | None
    noise_m: float  # standard deviation of one position, m
    goodness: GoodnessOfFit | None = None  # of the law that was judged; None where no law could be fitted at all
    # departure of friction, % of Fs, that half of all repetitions of this record would show
    # (`fitting.adequacy.visible`)
    smallest_visible: float | None = None
    # friction against relative speed without a law, in newtons where mass or stiffness is known
    curve: MeasuredCurve | None = None
    # of the curve, where it was judged: no law is adequate, or it leaves far more than the noise
    curve_goodness: GoodnessOfFit | None = None
    # where each law leaves the curve's band the furthest
    outside_band: Mapping[int | str, BandExit] = field(default_factory=dict)
    unit: str = "N/kg"  # of the curve's friction
    departures: tuple[FittedDeparture, ...] = ()  # those with which a law describes the record, strongest first
    # standard deviation of random friction within slips, over Fs, where that is what no law describes
    fluctuation: float | None = None

    @property
    def said(self) -> str:
        """The verdict in words, or `NOT_JUDGED`."""
        return self.verdict or NOT_JUDGED

    @property
    def adequate(self) -> bool:
        return self.verdict == ADEQUATE

    @property
    def rejected(self) -> bool:
        """Whether no law describes the record; neither this nor `adequate` holds where nothing could be judged."""
        return self.verdict is not None and not self.adequate

    @property
    def of_speed(self) -> bool:
        return self.curve is not None and (self.curve_goodness is None or not self.curve_goodness.rejected)

    def as_json(self) -> dict[str, Any]:
        found = self.goodness
        return {
            "verdict": self.verdict,
            "noise_m": self.noise_m,
            "misfit": found and found.misfit,
            "lag1": found and found.lag1,
            "repeat": found and found.repeat,
            "p_value": found and found.p_value,
            "smallest_visible": self.smallest_visible,
            "departures": [departure.as_json() for departure in self.departures],
            "curve": None if self.curve is None else curve_as_json(self.curve, self.unit),
        }


def curve_as_json(curve: MeasuredCurve, unit: str) -> dict[str, Any]:
    """Return the document's form of a measured curve."""
    k_over_m = curve.k_over_m.as_json()
    del k_over_m["unit"]
    return {
        "speed": curve.speed.tolist(),
        "friction": curve.friction.tolist(),
        "lo": curve.lo.tolist(),
        "hi": curve.hi.tolist(),
        "unit": unit,
        "k_over_m": k_over_m,
        "chi": curve.chi,
    }
