"""Options of imports and captures: arguments of `daq import`, `replay` and `decode`, one flag for each field."""

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from stickslip.console import flags
from stickslip.console.rig_flags import RigFlags
from stickslip.units import Measured


@Parameter(name="*")
@dataclass(frozen=True)
class ImportOptions(RigFlags):
    """Columns, units and rig of a table; None where not given.  Quantities are in SI."""

    position: Annotated[str | None, Parameter(help="Column of positions: its name, or its number from 1.")] = None
    time: Annotated[str | None, Parameter(help="Column of times: its name, or its number from 1.")] = None
    x_unit: Annotated[
        str | None,
        Parameter(
            help="Unit of positions, such as cm or '0.25 mm' (per pixel); by default that of the header, or m if it "
            "has none."
        ),
    ] = None
    t_unit: Annotated[
        str | None, Parameter(help="Unit of times; by default that of the header, or s if it has none.")
    ] = None
    spring_force: Annotated[
        str | None,
        Parameter(
            help="Column of the force of a pulling spring, instead of --position. The position is force / "
            "--stiffness, and --belt-speed is the pulling speed."
        ),
    ] = None
    force_unit: Annotated[
        str | None,
        Parameter(
            help="Unit of --spring-force; by default that of the header, or N if it has none. Use 'weight' for a force "
            "divided by the weight of the slider; without --mass, positions are then in units of weight / "
            "stiffness."
        ),
    ] = None
    belt_column: Annotated[
        str | None,
        Parameter(help="Column of the belt, by name or number. Its unit tells whether it is a position or a speed."),
    ] = None
    belt_unit: Annotated[
        str | None, Parameter(help="Unit of --belt-column, such as mm or mm/s, if the header has none.")
    ] = None
    clock: Annotated[bool, Parameter(negative=(), help="Times are times of day, such as 12:00:00.000.")] = False
    sheet: Annotated[str | None, Parameter(help="Sheet of a workbook (.xlsx), if several contain a table.")] = None
    segment: Annotated[
        int | None,
        Parameter(help="Number of the measurement, counted from 1, if the file contains several; 0 joins all of them."),
    ] = None
    preamble: Annotated[int, Parameter(help="Number of lines to skip above the header.")] = 0
    skip_bad: Annotated[
        bool, Parameter(negative=(), help="Skip lines that cannot be read, and report their number.")
    ] = False
    frame_rate_hz: Annotated[
        float | None,
        flags.rate(
            "--frame-rate", "True frame rate of the camera, such as '400 fps'. It provides or corrects the times."
        ),
    ] = None
    datum: Annotated[Measured | None, flags.measured("--datum", "length", "-x0.", "datum"), Parameter(show=False)] = (
        None
    )
    started: Annotated[
        str | None,
        Parameter(name="--start", help="Start time in ISO 8601 with a time zone; by default the date of the file."),
    ] = None


NO_OPTIONS = ImportOptions()


@Parameter(name="*")
@dataclass(frozen=True)
class ProbeOptions:
    """The probes of a capture and what decodes them; None where not given."""

    channels: Annotated[
        str | None,
        Parameter(help="Probes of the quadrature pair as A=NAME,B=NAME, where NAME is a name or an index from 0."),
    ] = None
    step: Annotated[str | None, Parameter(help="Probe of the step pulses, by name or by index from 0.")] = None
    direction: Annotated[
        str | None, Parameter(name="--dir", help="Probe of the direction; a high level counts up.")
    ] = None
    decoder: Annotated[str | None, Parameter(help="Decoder: 'x4' (default), 'x1', 'jk' or 'jk-latched'.")] = None


@Parameter(name="*")
@dataclass(frozen=True)
class CaptureOptions(ProbeOptions):
    """How a capture becomes a run; None where not given."""

    rate: Annotated[
        float | None,
        flags.rate(
            "--rate", "Sample rate of the run made from a capture; default 1000 Hz, or the rate of a slower capture."
        ),
    ] = None
    capture_rate: Annotated[
        float | None, flags.rate("--capture-rate", "Sample rate of the capture, if its metadata do not contain it.")
    ] = None


NO_PROBES = ProbeOptions()
NO_CAPTURE = CaptureOptions()
