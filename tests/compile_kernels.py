"""Compile the kernels that most tests call and keep them (`make kernels`); two test processes would each compile them.

What the commands print is dropped, unless one of them fails.

Smoothing and the fit of six laws, the listing of events, the ring-down, two masses, and a driven mass.
"""

import contextlib
import io
import sys
from pathlib import Path

import numpy as np

import daq
import fitting
import processing
from daq.calibration import ring_down
from rig_sim.cli.app import app
from rig_sim.flow.flow import Flow
from rig_sim.integrate.events import list_events
from stickslip.console import application
from stickslip.errors import EXIT_DONE

fitting.rank(processing.smooth(daq.load(Path(__file__).parents[1] / "data_samples" / "law5.h5")))
list_events(Flow(), 0.0, 0.0, 1e-9, compiled=True)
ring_down.predict_motion(np.linspace(0.0, 1.0, 3), 1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
for command in ("map two-mass --d 0.1 --iterate 600", "lyapunov forced --events 20"):
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        code = application.run(app, [*command.split(), "--json"])
    if code != EXIT_DONE:
        sys.exit(f"rig-sim {command}: {printed.getvalue()}")
