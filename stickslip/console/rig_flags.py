"""Flags that state what is known of a rig, in place of a rig.toml or beside one."""

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from stickslip.console import flags
from stickslip.console.application import Whole
from stickslip.errors import InputError
from stickslip.units import Measured, check_measured

Mass = Annotated[
    Measured | None, flags.measured("--mass", "mass", "Moving mass: '0.3', '300 g', '300 g +- 1 g'.", "mass")
]
Stiffness = Annotated[
    Measured | None, flags.measured("--stiffness", "stiffness", "Spring: '10.5', '10.5 N/m +- 0.1 N/m'.", "stiffness")
]
RestPosition = Annotated[
    Measured | None,
    flags.measured("--x0", "length", "Reading at the spring's rest: '60 mm', '-60 mm +- 0.1 mm'.", "x0"),
]


@Parameter(name="*")
@dataclass(frozen=True)
class PitchFlags:
    """What a count of the encoder is; None where not given."""

    metres_per_count: Annotated[
        Measured | None,
        flags.measured(
            "--metres-per-count",
            "length",
            "Travel in a count, '7.67 um'; negative where counting up means towards -x.",
            "metres_per_count",
        ),
    ] = None
    counts_per_rev: Annotated[
        int | None, Whole, Parameter(help="Counts in a turn of the encoder; with --circumference.", group=flags.RIG)
    ] = None
    circumference: Annotated[
        Measured | None,
        flags.measured("--circumference", "length", "Travel in a turn, '125.66 mm'; negative as --metres-per-count."),
    ] = None

    def stated(self) -> dict[str, Measured | int]:
        """Return the given quantities by the attributes of `daq.runfile.rig.Rig`."""
        turn, travel = self.counts_per_rev, self.circumference
        if turn is None and travel is None:
            return {} if self.metres_per_count is None else {"metres_per_count": self.metres_per_count}
        if turn is None or travel is None:
            missing = "--counts-per-rev" if turn is None else "--circumference"
            flag = "--circumference" if turn is None else "--counts-per-rev"
            raise InputError(f"{flag} without {missing}", "command line", f"give {missing} too, or --metres-per-count")
        if self.metres_per_count is not None:
            what = "--metres-per-count beside --counts-per-rev and --circumference"
            raise InputError(what, "command line", "give one or the other")
        if turn <= 0:
            raise InputError(f"is {turn}", "--counts-per-rev", "give a positive whole number")
        pitch = check_measured("metres_per_count", travel.value / turn, abs(travel.sd / turn), "--circumference")
        return {"metres_per_count": pitch, "counts_per_revolution": turn}


@Parameter(name="*")
@dataclass(frozen=True)
class RigFlags(PitchFlags):
    """What is known of a rig; None where not given."""

    mass: Mass = None
    stiffness: Stiffness = None
    belt_speed: Annotated[
        Measured | None,
        flags.measured(
            "--belt-speed", "speed", "Belt speed towards +x: '0.22', '22 cm/s'.", "belt_speed", old_name="--belt"
        ),
    ] = None
    x0: RestPosition = None

    def stated(self) -> dict[str, Measured | int]:
        """Return the given quantities by the attributes of `daq.runfile.rig.Rig`."""
        stated = {name: getattr(self, name) for name in ("mass", "stiffness", "belt_speed", "x0")}
        return super().stated() | {name: value for name, value in stated.items() if value is not None}


NO_RIG = RigFlags()
