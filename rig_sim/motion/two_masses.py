"""Two masses played: their events, and their exact motion in columns.

The kind of an event names the contact of both masses before and after, the first mass first: 'SS>SN' is the second
mass's break-away out of a global stick, 'NN>NS' its landing.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from rig_sim.flow.contact_state import force
from rig_sim.flow.frame import mirror_mode
from rig_sim.flow.modes import EVENT_LIMIT, LETTERS, OUTCOMES, STICK
from rig_sim.flow.two_mass import slip_start
from rig_sim.integrate.pair_motion import EVENTS, SAMPLES, PairMotion
from rig_sim.integrate.two_mass import load
from rig_sim.motion.play import DEFAULT_MAX_STEPS, MOST_EVENTS, Events
from rig_sim.scenes.model import Scene
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

COLUMNS = {
    "t": ("time", "s"),
    "x1": ("position of the first mass", "m"),
    "v1": ("velocity of the first mass", "m/s"),
    "F1": ("friction force on the first mass, positive towards +x", "N"),
    "x2": ("position of the second mass", "m"),
    "v2": ("velocity of the second mass", "m/s"),
    "F2": ("friction force on the second mass, positive towards +x", "N"),
}


@dataclass(frozen=True, slots=True)
class TwoMassEvent:
    """At time t (s) and positions x1, x2 (m) one mass passed from one kind of contact to another: 'SS>SN'."""

    t: float
    x1: float
    x2: float
    kind: str


def find_start(scene: Scene) -> tuple[float, float, float, float]:
    """Return x1, v1, x2, v2 (m, m/s) at t = 0."""
    section = scene.start
    if section.d is None and section.attractor is None:
        return section.x1 or 0.0, section.v1 or 0.0, section.x2 or 0.0, section.v2 or 0.0
    flow = scene.two_mass_flow()
    try:
        x1, x2 = slip_start(flow, find_stretch(scene))
    except ValueError as error:
        raise InputError(str(error), "start.d", "use another start.d, or start.x1, v1, x2, v2") from None
    return x1, flow.mass.v_belt, x2, flow.mass.v_belt


def find_stretch(scene: Scene) -> float:
    """Return x2 - x1 (m) of the global stick with which a scene starts."""
    section = scene.start
    if section.d is not None:
        return section.d
    if section.attractor is None:
        raise InputError("does not begin in a global stick", f"scene {scene.name}", "set start.d or start.attractor")
    from rig_sim.analyses.basins import basins
    from rig_sim.analyses.section import CELLS
    from rig_sim.systems.stick import StickMap

    flow = scene.two_mass_flow()
    attractors = basins(StickMap(flow), CELLS).attractors if flow.mass.v_belt else ()
    if section.attractor > len(attractors):
        problem = (
            f"start.attractor is {section.attractor}, but the map from stick to stick has {len(attractors)} attractors"
        )
        raise InputError(problem, f"scene {scene.name}", "use another number, or start.d")
    return attractors[section.attractor - 1].points[0]


def two_mass_events(
    scene: Scene, until: float, *, since: float = 0.0, max_steps: int = DEFAULT_MAX_STEPS
) -> Events[TwoMassEvent]:
    """Return when and where the masses stick and slip, from t = 0 to ``until`` (s)."""
    motion = PairMotion(scene.two_mass_flow(), find_start(scene), max_steps)
    fr = motion.frame
    events: list[TwoMassEvent] = []
    outcome = None
    for t, y1, _, mode1, y2, _, mode2, before1, before2 in motion.rows([until], EVENTS):
        if t < since:
            continue
        if len(events) == MOST_EVENTS:
            outcome = OUTCOMES[EVENT_LIMIT]
            break
        old1, old2, new1, new2 = (LETTERS[mirror_mode(fr, int(mode))] for mode in (before1, before2, mode1, mode2))
        events.append(TwoMassEvent(t, fr.x0 + fr.mirror * y1, fr.x0 + fr.mirror * y2, f"{old1}{old2}>{new1}{new2}"))
    outcome = outcome or motion.outcome
    return Events(tuple(events), outcome.name, outcome.advice, motion.steps)


class TwoMassPlayer:
    """Plays a scene of two masses forwards in time, for a file: see `rig_sim.motion.file`."""

    def __init__(self, scene: Scene, *, max_steps: int = DEFAULT_MAX_STEPS) -> None:
        self.scene = scene
        self._motion = PairMotion(scene.two_mass_flow(), find_start(scene), max_steps)
        self.outcome = self._motion.outcome

    @property
    def steps(self) -> int:
        return self._motion.steps

    def columns(self, instants: Array) -> tuple[Array, ...]:
        """Play through increasing times (s) and return the `COLUMNS`, each (n,): fewer where the motion ends."""
        fr, flow = self._motion.frame, self._motion.flow
        forwards = partial(force, flow.mass._replace(v_belt=fr.v))
        rows = []
        for t, y1, w1, mode1, y2, w2, mode2, _, _ in self._motion.rows(instants, SAMPLES):
            row = [t]
            for y, w, mode, other, ratio in ((y1, w1, mode1, y2, 1.0), (y2, w2, mode2, y1, flow.b)):
                F = load(fr, flow.a, y, other) if mode == STICK else ratio * forwards(int(mode), 0.0, w, 0.0)
                row += [fr.x0 + fr.mirror * y, fr.mirror * (w + fr.v), fr.mirror * F]
            rows.append(row)
        self.outcome = self._motion.outcome
        return tuple(np.array(rows).reshape(-1, len(COLUMNS)).T)
