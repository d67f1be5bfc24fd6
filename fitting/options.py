"""The options of a fit, the same for every run."""

import math
from dataclasses import dataclass, field, replace
from numbers import Real

from daq.runfile.rig import Rig
from fitting.laws import SIX, Competitors, Law
from stickslip.errors import InputError
from stickslip.units import Measured

LEAST_ALPHA = 1e-9  # 1 - confidence


@dataclass(frozen=True)
class Options:
    """The options of a fit; None for the run's own calibration."""

    competitors: Competitors = field(default_factory=Competitors)
    mass: Measured | None = None  # kg
    stiffness: Measured | None = None  # N/m
    x0: Measured | None = None  # m
    datum: Measured | None = None  # m: -x0, from the readings of which the run was made
    datum_sd: float | None = None
    damping: Measured | None = None  # N s/m
    damping_sd: float | None = None
    belt_speed: Measured | float | str | None = None  # m/s, signed, or "channel"
    excluded: tuple[int, ...] = ()  # numbers of cycles
    begin: float | None = None  # s of the run
    end: float | None = None
    alpha: float = 0.05
    jobs: int = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.alpha, Real) and LEAST_ALPHA <= self.alpha < 1):
            do = f"it must be a number from {LEAST_ALPHA:g} to 1, such as 0.05"
            raise InputError(f"alpha is {self.alpha!r}", "--alpha", do)
        if not (isinstance(self.jobs, int) and self.jobs >= 1):
            raise InputError(f"jobs is {self.jobs!r}", "--jobs", "it must be 1 or more")
        if self.mass is not None and self.stiffness is not None:
            raise InputError(
                "--mass and --stiffness cannot be combined", "--mass", "state only one: the fit determines the other"
            )
        for name, stated in (("mass", self.mass), ("stiffness", self.stiffness)):
            if stated is not None and not stated.value > 0:
                raise InputError(f"{name} is {stated.value}", f"--{name}", "it must be above 0")
        if self.x0 is not None and (self.datum is not None or self.datum_sd is not None):
            other = "--datum" if self.datum is not None else "--datum-sd"
            raise InputError(
                f"--x0 and {other} cannot be combined",
                "command line",
                "use only --x0, with its error after +-; the datum is -x0",
            )

    def fixed(self, law: Law) -> dict[str, float]:
        """Return the fixed parameters of a requested law; none for others."""
        given = self.competitors.of_law(law) if self.competitors.asks(law) else {}
        return {name: one.low for name, one in given.items() if one.fixed}

    def check_joint(self) -> None:
        """Raise InputError for options of a single run."""
        if self.belt_speed is not None and self.belt_speed != "channel":
            raise InputError(
                "a joint fit does not accept one belt speed for all runs",
                "--belt-speed",
                "omit it: a belt speed is fitted for each run",
            )
        if self.excluded:
            do = "fit that run separately, or omit the flag"
            raise InputError("cycles cannot be excluded from a joint fit", "--exclude-cycles", do)

    def calibrate(self, rig: Rig) -> Rig:
        if self.mass is not None:
            rig = replace(rig, mass=self.mass)
        if self.stiffness is not None:
            rig = replace(rig, mass=None, stiffness=self.stiffness)
        if self.x0 is not None:
            rig = rig.resting_at(_changed("--x0", None, self.x0, None))
        if self.datum_sd is not None and self.datum is None and rig.datum is None:
            raise InputError("--datum-sd requires a datum", "--datum-sd", "use --x0 with +- instead")
        if self.datum is not None or self.datum_sd is not None:
            rig = replace(rig, datum=_changed("--datum", rig.datum, self.datum, self.datum_sd), x0=None)
        if self.damping is None and self.damping_sd is None:
            return rig
        damping = _changed("--damping", rig.damping, self.damping, self.damping_sd)
        if damping.value < 0:
            raise InputError(f"damping is {damping.value}", "--damping", "it must be 0 or more, in N s/m")
        if rig.mass is None and rig.stiffness is None:
            raise InputError(
                "--damping in N s/m requires the mass or the stiffness", "--damping", "add --mass or --stiffness"
            )
        return replace(rig, damping=damping)

    @property
    def laws_fitted(self) -> list[str]:
        """The laws, unless the six alone, and the conditions, in words."""
        laws, names = ([law.name for law in laws] for laws in (self.competitors.six, self.competitors.formulas))
        said = []
        if laws and len(laws) < len(SIX):
            said.append(f"law{'s' * (len(laws) > 1)} {', '.join(laws)}")
        if names:
            said.append(f"{'with ' if laws else ''}law{'s' * (len(names) > 1)} {', '.join(names)}")
        if self.competitors.fix:
            said.append(", ".join(f"{name} = {value:g}" for name, value in self.competitors.fix.items()))
        if self.competitors.bounds:
            said.append(f"bounds of {', '.join(self.competitors.bounds)}")
        if self.excluded:
            said.append(f"without cycle{'s' * (len(self.excluded) > 1)} {', '.join(map(str, self.excluded))}")
        return said


def _changed(flag: str, known: Measured | None, typed: Measured | None, sd: float | None) -> Measured:
    """Return a calibration with value or error replaced; a new value without an error is exact."""
    if typed is not None and typed.sd and sd is not None:
        raise InputError(
            f"{flag} with +- and {flag}-sd cannot be combined", "command line", "state the error only once"
        )
    value, typed_sd = (typed.value, typed.sd) if typed is not None else (0.0 if known is None else known.value, 0.0)
    sd = typed_sd if sd is None else sd
    if not math.isfinite(value):
        raise InputError(f"is {value}", flag, "use a number")
    if not 0 <= sd < math.inf:
        raise InputError(f"the standard deviation is {sd}", f"{flag}-sd", "it must be 0 or more")
    return Measured(float(value), float(sd))
