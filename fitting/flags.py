"""The flags of `fit-friction` in groups; each group is an argument of the command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from stickslip.console import flags
from stickslip.console.rig_flags import Mass, RestPosition, Stiffness
from stickslip.units import Measured

Words = list[str] | None
OLD = Parameter(show=False)  # spellings of earlier releases


def _repeated(text: str, metavar: str) -> Parameter:
    return Parameter(negative=(), consume_multiple=False, metavar=metavar, help=f"{text}; repeatable.")


def _file(text: str, *names: str) -> Parameter:
    return Parameter(name=names or None, metavar="FILE", help=text)


@Parameter(name="*", group=flags.LAWS)
@dataclass(frozen=True)
class LawFlags:
    """The laws that compete, and the conditions on their parameters."""

    laws: Annotated[str, Parameter(metavar="LIST", help="Laws to fit, such as 1-6, 3,5,6 or 1-6,stribeck.")] = "1-6"
    law: Annotated[
        Words,
        _repeated(
            "Additional law: a published name (stribeck, lugre ...), or 'NAME: FORMULA' with slip speed s", "LAW"
        ),
    ] = None
    ramp: Annotated[Words, _repeated("Replace the jump of this law by a ramp", "NAME")] = None
    fix: Annotated[Words, _repeated("Fix a parameter, such as gamma=9.6 or 'mine.v_s=50 mm/s'", "NAME=VALUE")] = None
    bound: Annotated[Words, _repeated("Bounds of a parameter; LO: or :HI sets only one", "NAME=LO:HI")] = None
    start: Annotated[Words, _repeated("Initial value of a parameter", "NAME=VALUE")] = None


@Parameter(name="*", group=flags.RIG)
@dataclass(frozen=True)
class CalibrationFlags:
    """Calibrations that override the run's own."""

    mass: Mass = None
    stiffness: Stiffness = None
    x0: RestPosition = None
    datum: Annotated[Measured | None, flags.measured("--datum", "length", "-x0.", "datum"), OLD] = None
    datum_sd: Annotated[float | None, flags.quantity("--datum-sd", "length", "Error of --datum."), OLD] = None
    damping: Annotated[
        Measured | None,
        flags.measured("--damping", "damping", "Viscous damping, N s/m: '0.02 +- 0.001'.", "damping"),
    ] = None
    damping_sd: Annotated[float | None, flags.quantity("--damping-sd", "damping", "Error of --damping."), OLD] = None
    belt_speed: Annotated[
        Measured | str | None,
        flags.measured(
            "--belt-speed",
            "speed",
            "Signed belt speed, such as '22 cm/s +- 1 mm/s', or 'channel' to use the belt counts.",
            word="channel",
        ),
    ] = None


@Parameter(name="*", group=flags.PART)
@dataclass(frozen=True)
class PartFlags:
    """The fitted part of each run, and the confidence."""

    begin: Annotated[
        float | None, flags.quantity("--from", "time", "Start of the fitted part, such as '5' or '1.5 min'.")
    ] = None
    end: Annotated[float | None, flags.quantity("--to", "time", "End of the fitted part.")] = None
    exclude_cycles: Annotated[
        str, Parameter(metavar="LIST", help="Cycles to exclude, counted from 1, such as 3,7-9.")
    ] = ""
    confidence: Annotated[
        float, Parameter(metavar="C", help="Confidence level of the intervals and of the set of laws.")
    ] = 0.95
    alpha: Annotated[float | None, Parameter(help="1 - confidence."), OLD] = None


@Parameter(name="*", group=flags.OUTPUT)
@dataclass(frozen=True)
class OutputFlags:
    """Files written besides the run."""

    report: Annotated[
        Path | None, _file("File of the report; default RUN.report.html.", "--output", "-o", "--report")
    ] = None
    no_report: Annotated[bool, Parameter(negative=(), help="Do not write a report.")] = False
    csv: Annotated[Path | None, _file("Also write the ranking as a table.")] = None
    curve_csv: Annotated[Path | None, _file("Also write the measured friction curve with its band.")] = None
    save_scene: Annotated[Path | None, _file("Also write the fitted rig as a scene (.toml) for rig-sim.")] = None
    force: Annotated[
        bool, Parameter(negative=(), help="Replace existing files, even if they belong to other runs.")
    ] = False


@Parameter(name="*", group=flags.RUNS)
@dataclass(frozen=True)
class WorkFlags:
    """Separate fits, and the processors."""

    each: Annotated[bool, Parameter(negative=(), help="Fit every run separately.")] = False
    jobs: Annotated[int, Parameter(metavar="N", help="Number of processes; a joint fit uses at most three.")] = 1
    scheduler: Annotated[
        str | None, Parameter(metavar="URL", help="Address of a dask scheduler, such as tcp://host:8786.")
    ] = None


DEFAULT_LAWS, DEFAULT_RIG, DEFAULT_PART = LawFlags(), CalibrationFlags(), PartFlags()
DEFAULT_OUTPUTS, DEFAULT_WORK = OutputFlags(), WorkFlags()
