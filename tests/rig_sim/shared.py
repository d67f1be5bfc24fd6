"""What test files of the simulator share: published numbers, a law's flow, a command's answer, a flow's motion."""

import contextlib
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig_sim.cli.app import app
from rig_sim.flow import modes
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import new_samples
from rig_sim.integrate.phases import State, sample_phase
from rig_sim.integrate.work import new_work
from stickslip.console import application

REFERENCE_FOLDER = Path(__file__).parents[1] / "reference"
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
CHAPTERS = json.loads((REFERENCE_FOLDER / "dynamics.json").read_text())
LIMIT_CYCLES = json.loads((REFERENCE_FOLDER / "limit_cycles.json").read_text())


def flow_of(law: int, **changes: Any) -> Flow:
    return Flow(curve=LAWS[law].curve_code, ramp=LAWS[law].ramp, **changes)


def answer(line: str, *words: object, code: int = 0) -> Any:
    """Return what a command line of rig-sim prints under --json; words are those that may hold blanks."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert application.run(app, [*line.split(), *map(str, words), "--json"]) == code
    return json.loads(printed.getvalue())


def settings(*changes: str) -> list[str]:
    return [word for change in changes for word in ("--set", change)]


def sample_motion(flow: Flow, x: float, v: float, times: Sequence[float]) -> tuple[Any, Any]:
    """Return x (m) and v (m/s), (n,) each, at increasing times (s); the motion starts at the first of them."""
    samples, i, work = new_samples(list(times), compiled=False), 0, new_work()
    at = State(initial_mode(flow, x, v, times[0]), x, v - flow.v_belt, times[0])
    while i < samples.n:
        kind, at, i = sample_phase(flow, at, times[-1], samples, i, work)
        assert kind < modes.FORCE_REVERSAL
    return np.array(samples.x), np.array(samples.v)
