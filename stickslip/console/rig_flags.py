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
    flags.measured("--x0", "length", "Position reading with the spring relaxed, such as '60 mm +- 0.1 mm'.", "x0"),
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
            "Travel per count, such as '7.67 um'; negative if counting up means moving towards -x.",
            "metres_per_count",
        ),
    ] = None
    counts_per_rev: Annotated[
        int | None,
        Whole,
        Parameter(help="Counts per revolution of the encoder; requires --circumference.", group=flags.RIG),
    ] = None
    circumference: Annotated[
        Measured | None,
        flags.measured(
            "--circumference",
            "length",
            "Travel per revolution, such as '125.66 mm'; its sign is that of --metres-per-count.",
        ),
    ] = None

    def stated(self) -> dict[str, Measured | int]:
        """Return the given quantities by the attributes of `daq.runfile.rig.Rig`."""
        turn, travel = self.counts_per_rev, self.circumference
        if turn is None and travel is None:
            return {} if self.metres_per_count is None else {"metres_per_count": self.metres_per_count}
        if turn is None or travel is None:
            missing = "--counts-per-rev" if turn is None else "--circumference"
            flag = "--circumference" if turn is None else "--counts-per-rev"
            raise InputError(f"{flag} requires {missing}", "command line", f"add {missing}, or use --metres-per-count")
        if self.metres_per_count is not None:
            what = "--metres-per-count cannot be combined with --counts-per-rev and --circumference"
            raise InputError(what, "command line", "use one or the other")
        if turn <= 0:
            raise InputError(f"is {turn}", "--counts-per-rev", "use a positive whole number")
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
            "--belt-speed",
            "speed",
            "Belt speed, positive towards +x, such as '0.22' or '22 cm/s'.",
            "belt_speed",
            old_name="--belt",
        ),
    ] = None
    x0: RestPosition = None

    def stated(self) -> dict[str, Measured | int]:
        """Return the given quantities by the attributes of `daq.runfile.rig.Rig`."""
        stated = {name: getattr(self, name) for name in ("mass", "stiffness", "belt_speed", "x0")}
        return super().stated() | {name: value for name, value in stated.items() if value is not None}


NO_RIG = RigFlags()
