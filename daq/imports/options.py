"""Options of an import: an argument of `daq import`, each field one of its flags."""

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from daq.console import flags
from daq.runfile.rig import Measured


@Parameter(name="*")
@dataclass(frozen=True)
class ImportOptions:
    """Columns, units and rig of a table; None where not given.  Quantities are in SI."""

    position: Annotated[str | None, Parameter(help="Column of positions: its name, or its number from 1.")] = None
    time: Annotated[str | None, Parameter(help="Column of times: its name, or its number from 1.")] = None
    x_unit: Annotated[
        str | None,
        Parameter(help="Unit of positions, such as cm or '0.25 mm' (per pixel); default from the header, else m."),
    ] = None
    t_unit: Annotated[str | None, Parameter(help="Unit of times; default from the header, else s.")] = None
    frame_rate_hz: Annotated[
        float | None,
        flags.rate("--frame-rate", "The camera's true rate, '400 fps': makes or corrects the times."),
    ] = None
    mass: Annotated[
        Measured | None, flags.measured("--mass", "mass", "Moving mass: '0.3', '300 g', '300 g +- 1 g'.", "mass")
    ] = None
    stiffness: Annotated[
        Measured | None, flags.measured("--stiffness", "stiffness", "Spring: '10.5', '10.5 N/m'.", "stiffness")
    ] = None
    belt_speed: Annotated[
        Measured | None, flags.measured("--belt", "speed", "Belt speed towards +x: '0.22', '22 cm/s'.", "belt_speed")
    ] = None
    datum: Annotated[
        Measured | None,
        flags.measured("--datum", "length", "Position of the table's x = 0, from the spring's rest position.", "datum"),
    ] = None
    started: Annotated[
        str | None, Parameter(name="--start", help="Start time, ISO 8601 with time zone; default the file's date.")
    ] = None
    title: Annotated[str | None, Parameter(help="Title of the run.")] = None


NO_OPTIONS = ImportOptions()
