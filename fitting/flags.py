"""The flags of `fit-friction` in groups; each group is an argument of the command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from stickslip.console import flags
from stickslip.console.rig_flags import Mass, RestPosition, Stiffness
from stickslip.units import Measured


def _repeated(text: str) -> Parameter:
    return Parameter(negative=(), consume_multiple=False, help=f"{text.removesuffix('.')}; repeatable.")


@Parameter(name="*")
@dataclass(frozen=True)
class LawFlags:
    """The laws that compete, and the conditions on their parameters."""

    laws: Annotated[
        str, Parameter(help="Laws to fit: 1-6, or a list such as 3,5,6; published ones by name: 1-6,stribeck.")
    ] = "1-6"
    law: Annotated[
        list[str] | None,
        _repeated(
            "One more law: a published one (stribeck, stribeck-gaussian, either with -viscous, logarithmic, power; "
            "with memory: lugre, dahl, ageing, slip), or 'NAME: FORMULA', friction per unit mass at slip speed s."
        ),
    ] = None
    ramp: Annotated[list[str] | None, _repeated("Put the law of this name behind a ramp.")] = None
    fix: Annotated[
        list[str] | None,
        _repeated("A parameter that is known, NAME=VALUE as the results name it: gamma=9.6, 'mine.v_s=50 mm/s'."),
    ] = None
    bound: Annotated[list[str] | None, _repeated("Bounds of a parameter: NAME=LO:HI, LO: or :HI.")] = None
    start: Annotated[list[str] | None, _repeated("First value of a parameter, NAME=VALUE.")] = None


@Parameter(name="*")
@dataclass(frozen=True)
class CalibrationFlags:
    """Calibrations that override the run's own."""

    mass: Mass = None
    stiffness: Stiffness = None
    x0: RestPosition = None
    datum: Annotated[
        Measured | None,
        flags.measured("--datum", "length", "-x0, from the readings of which the run was made; use --x0.", "datum"),
    ] = None
    datum_sd: Annotated[
        float | None, flags.quantity("--datum-sd", "length", "Standard deviation of --datum; use --x0 with +-.")
    ] = None
    damping: Annotated[
        Measured | None,
        flags.measured("--damping", "damping", "Viscous damping from a ring-down, N s/m: '0.02 +- 0.001'.", "damping"),
    ] = None
    damping_sd: Annotated[
        float | None, flags.quantity("--damping-sd", "damping", "Standard deviation of --damping, N s/m.")
    ] = None
    belt_speed: Annotated[
        Measured | str | None,
        flags.measured(
            "--belt-speed",
            "speed",
            "Belt speed, signed: '22 cm/s +- 1 mm/s'; channel: from belt counts, the default if the run contains them.",
            word="channel",
        ),
    ] = None


@Parameter(name="*")
@dataclass(frozen=True)
class PartFlags:
    """The fitted part of each run, and the confidence."""

    exclude_cycles: Annotated[str, Parameter(help="Cycles to leave out, counted from 1: 3,7-9.")] = ""
    begin: Annotated[
        float | None, flags.quantity("--from", "time", "Fit from this time of the run, s or with a unit.")
    ] = None
    end: Annotated[float | None, flags.quantity("--to", "time", "Fit up to this time of the run, likewise.")] = None
    alpha: Annotated[float, Parameter(help="1 - confidence level of the intervals and the set.")] = 0.05


@Parameter(name="*")
@dataclass(frozen=True)
class OutputFlags:
    """Files written besides the run."""

    report: Annotated[
        Path | None,
        Parameter(
            help="Report to write; default RUN.report.html, of a joint fit RUN+N.report.html; with --each numbered."
        ),
    ] = None
    no_report: Annotated[bool, Parameter(negative=(), help="Write no report.")] = False
    csv: Annotated[Path | None, Parameter(help="Also write the ranking as a table with one row per run and law.")] = (
        None
    )
    curve_csv: Annotated[
        Path | None,
        Parameter(help="Also write the measured friction curve with its band: relative speed, friction, lo, hi."),
    ] = None
    save_scene: Annotated[
        Path | None,
        Parameter(help="Also write the fitted rig as a scene (.toml) for rig-sim: the law, or the measured curve."),
    ] = None
    force: Annotated[
        bool, Parameter(negative=(), help="Replace a report, table or joint fit that is not of these runs.")
    ] = False


@Parameter(name="*")
@dataclass(frozen=True)
class WorkFlags:
    """Separate fits, and the processors."""

    each: Annotated[bool, Parameter(negative=(), help="Fit every run by itself: a batch.")] = False
    jobs: Annotated[int, Parameter(help="Processes to fit in; a joint fit uses at most three.")] = 1
    scheduler: Annotated[str | None, Parameter(help="Fit on the workers of a dask scheduler: tcp://host:8786.")] = None


DEFAULT_LAWS, DEFAULT_RIG, DEFAULT_PART = LawFlags(), CalibrationFlags(), PartFlags()
DEFAULT_OUTPUTS, DEFAULT_WORK = OutputFlags(), WorkFlags()
