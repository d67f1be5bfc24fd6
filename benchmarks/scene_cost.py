"""CPU time spent on terms that a scene does not have: the integrator against a kernel written for that scene alone.

``python benchmarks/scene_cost.py [REPEATS]`` (default 25): CPU time of both over the same interval, every
cycle integrated, alternating, the smallest of the repeats; both must find the same events.  The kernels are in
`benchmarks/hand/kernels.py`.  If a scene changes its friction or the velocity of the mass between events, a compiled
loop calls the integrator phase by phase, as `rig_sim.motion.play.ScenePlayer` does.  Then each scene writes a file in a
process of its own, which must load no module and store no channel of a term that the scene does not have.
"""

import json
import math
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from hand.kernels import KICK, LEAST_FACTOR, Constants, Terms, specialised
from hand.polynomial import SIZE

from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import displacement, frame
from rig_sim.flow.modes import COMPLETED, FORCE_REVERSAL, RAMP, STICK
from rig_sim.friction.curve import HYPERBOLIC, LINEAR
from rig_sim.integrate.compiled import compiled
from rig_sim.integrate.events import new_lists
from rig_sim.integrate.phases import State, next_event, run
from rig_sim.integrate.work import new_work, unboxed
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene

RESULTS = Path(__file__).resolve().parent / "results"
ROOM = 4096
ASKED = 1.05
LEAST_S = 0.01  # s of CPU time in one measurement: calls are repeated until it is reached
DRIVE = {"drive.u0": 0.2, "drive.omega": 0.3}
DAMPER = {"damper.c": 0.05}
STATIC = {"friction.static": 1.2}
SCATTER = {"scatter.Fs": 0.03}
WEAR = {"wear.rate": 2e-4}
JOINT = {"joint.kick": 0.02, "belt.length": 5.0}
DROOP = {"droop.fraction": 0.4}
SCENES: dict[str, dict[str, object]] = {
    "base": {},
    "law 1": {"friction.law": 1},
    "law 3": {"friction.law": 3},
    "law 4": {"friction.law": 4},
    "law 6": {"friction.law": 6},
    "damper": DAMPER,
    "drive": DRIVE,
    "ripple": {"belt.ripple": 0.02, "belt.ripple_hz": 0.3},
    "static > 1": STATIC,
    "droop": DROOP,
    "scatter": SCATTER,
    "wear": WEAR,
    "joint": JOINT,
    "drive, damper": {**DRIVE, **DAMPER},
    "static > 1, scatter": {**STATIC, **SCATTER},
    "law 6, drive": {"friction.law": 6, **DRIVE},
    "scatter, wear, joint": {**SCATTER, **WEAR, **JOINT},
    "everything": {**DRIVE, **DAMPER, **DROOP, **SCATTER, **WEAR, **JOINT},
}
# module that implements a term -> section or key that the scene must have for it
MODULES = {
    "rig_sim.effects.scatter": "scatter",
    "rig_sim.effects.wear": "wear",
    "rig_sim.effects.joint": "joint",
    "rig_sim.effects.ripple": "ripple",
    "rig_sim.board.board": "board",
    "rig_sim.comparison.stepping": "another method",
    "numba": "compiling",
    "scipy": "another method",
    "matplotlib": "pictures",
}
CHANNELS = {"t", "x", "v", "F"}


def constants(found: Scene) -> Constants:
    """Return the numbers of a scene for the hand-written kernels."""
    flow = found.flow()
    fr = frame(flow)
    return Constants(
        m=flow.m, k=flow.k, c=flow.c, v=flow.v_belt, Fs=flow.Fs, static=flow.static, G=fr.G, gamma=flow.gamma,
        d=fr.d, u0=flow.u0, omega=flow.omega, phase=flow.phase, lag=fr.lag,
        wear=found.wear.rate if found.wear else 0.0,
        kick=found.joint.kick if found.joint else 0.0,
        turn=found.belt.length / abs(found.belt.speed) if found.joint and found.belt and found.belt.length else 0.0,
    )  # fmt: skip


def terms(found: Scene) -> Terms:
    """Return which terms a scene has, for the hand-written kernels."""
    flow = found.flow()
    return Terms(
        hyperbola=flow.curve == HYPERBOLIC, linear=flow.curve == LINEAR, ramp=flow.ramp == 1, damper=flow.c > 0.0,
        drive=flow.u0 != 0.0, droop=flow.droop > 0.0, static=flow.static > 1.0,
        levels=found.wear is not None or found.scatter is not None, joint=found.joint is not None,
    )  # fmt: skip


def phase_by_phase(flow, at, t_max, factors, wear, kick, turn, levels, lists, work):
    """List events as `rig_sim.motion.play.ScenePlayer` does, with the engine's kernel; return their number."""
    work = unboxed(work)
    count = drawn = kicks = 0
    while True:
        end = min(t_max, (kicks + 1) * turn) if turn > 0.0 else t_max
        kind, at = next_event(flow, at, end, work)
        if kind >= FORCE_REVERSAL or (kind == COMPLETED and end == t_max):
            return count
        lists.t[count] = at.t
        lists.x[count] = at.x
        lists.kind[count] = kind
        count += 1
        if kind == COMPLETED:
            lists.kind[count - 1] = KICK
            kicks += 1
            w = at.w + kick
            was = at.mode
            at = State(initial_mode(flow, at.x, w + flow.v_belt, at.t), at.x, w, at.t, 0.0)
            if at.mode != was:
                lists.t[count] = at.t
                lists.x[count] = at.x
                lists.kind[count] = 4 * was + at.mode
                count += 1
        elif levels and (at.mode == STICK or at.mode == RAMP):
            factor = max(LEAST_FACTOR, (1.0 - wear * at.t) * factors[drawn])
            drawn += 1
            flow = Flow(
                flow.m, flow.k, flow.x0, flow.c, flow.v_belt, flow.curve, flow.ramp, flow.Fs, flow.static, factor,
                flow.G_slip, flow.gamma, flow.d, flow.u0, flow.omega, flow.phase, flow.droop, flow.pieces,
                flow.table,
            )  # fmt: skip


class Race:
    """One scene, played by the engine and by its own kernel, interpreted or compiled."""

    def __init__(self, name: str, until: float, *, machine: bool) -> None:
        self.scene = scene("base", **SCENES[name])
        flow = self.scene.flow()
        self.until = until
        plain, quick = specialised(terms(self.scene))
        con = constants(self.scene)
        x, v = float(self.scene.start.x), float(self.scene.start.v)
        draw = random.Random(7)
        sd = self.scene.scatter.Fs if self.scene.scatter else 0.0
        new = np.array if machine else list
        factors = new([1.0 + sd * draw.gauss(0.0, 1.0) for _ in range(ROOM)])
        self.mine = [new([0.0] * ROOM) for _ in range(3)]
        self.engines = new_lists(ROOM, compiled=machine)
        hand_work = new([0.0] * 5 * SIZE)
        fr = frame(flow)
        self.hand = quick if machine else plain
        self.hand_call = (
            con,
            displacement(fr, x),
            v - flow.v_belt,
            until,
            factors,
            *self.mine,
            hand_work,
            new_work(compiled=machine),
        )
        mode = initial_mode(flow, x, v, 0.0)
        self.whole = not (self.scene.wear or self.scene.scatter or self.scene.joint)
        start = (flow, State(mode, x, v - flow.v_belt, 0.0))
        if self.whole:
            self.engine = compiled(run) if machine else run
            self.engine_call = (*start, until, self.engines, 0)
        else:
            self.engine = compiled(phase_by_phase) if machine else phase_by_phase
            levels = 1 if terms(self.scene).levels else 0
            self.engine_call = (*start, until, factors, con.wear, con.kick, con.turn, levels, self.engines)
        self.machine = machine
        self.fresh()

    def fresh(self) -> None:
        """Give the integrator a new working buffer: the old one holds the rounding error of the time between calls."""
        self.work = new_work(10**9, compiled=self.machine)

    def run_engine(self) -> int:
        found = self.engine(*self.engine_call, self.work)
        return int(found[1] if self.whole else found)

    def run_hand(self) -> int:
        return int(self.hand(*self.hand_call))

    def difference(self) -> tuple[int, float]:
        """Return the number of events and the largest difference of their times; events must be the same."""
        self.fresh()
        count, other = self.run_engine(), self.run_hand()
        t_out, carry, _, kinds = (list(buffer)[:count] for buffer in self.engines[:4])
        mine_t, _, mine_kinds = (list(buffer)[:other] for buffer in self.mine)
        if count != other or [int(kind) for kind in kinds] != [int(kind) for kind in mine_kinds]:
            at = next((i for i, pair in enumerate(zip(kinds, mine_kinds, strict=False)) if pair[0] != pair[1]), -1)
            raise SystemExit(f"{count} and {other} events, the first other one is {at}: {kinds[at]}, {mine_kinds[at]}")
        pairs = zip(t_out, carry if self.whole else [0.0] * count, mine_t, strict=True)
        return count, max(abs(t + more - own) for t, more, own in pairs)

    def ratio(self, repeats: int) -> tuple[float, float, float]:
        """Return (CPU s of the integrator, CPU s of the hand-written kernel, median of the ratios of the pairs)."""
        begun = time.process_time()
        self.run_hand()
        once = time.process_time() - begun
        calls = max(1, math.ceil(LEAST_S / max(once, 1e-6)))
        least = [math.inf, math.inf]
        ratios = []
        for turn in range(repeats):
            pair = [0.0, 0.0]
            for which in (0, 1) if turn % 2 else (1, 0):
                play = self.run_hand if which else self.run_engine
                begun = time.process_time()
                for _i in range(calls):
                    play()
                pair[which] = (time.process_time() - begun) / calls
                least[which] = min(least[which], pair[which])
            ratios.append(pair[0] / pair[1])
        return least[0], least[1], sorted(ratios)[len(ratios) // 2]


def left_out(name: str, folder: str) -> dict[str, list[str]]:
    """Write the scene's motion to a file in a fresh process; return modules and channels that it does not need."""
    code = (
        "import sys, json; from pathlib import Path; from rig_sim.scenes.scene import scene;"
        "from rig_sim.motion.file import write;"
        f"write(scene('base', **{SCENES[name]!r}), Path('motion.h5'), until=20.0, rate=10.0, force=True);"
        "print(json.dumps(sorted(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    loaded = set(json.loads(done.stdout))
    found = scene("base", **SCENES[name])
    has = set(found.terms()) | ({"ripple"} if found.belt and found.belt.ripple else set())
    with h5py.File(Path(folder) / "motion.h5") as file:
        channels = set(file["entry/motion"]) - CHANNELS
        sections = set(json.loads(file["entry/simulation/scene"][()])) - has - {"name", "title", "seed"}
    return {
        "modules": sorted(module for module, term in MODULES.items() if module in loaded and term not in has),
        "channels": sorted(channels | sections),
    }


def main(repeats: int) -> None:
    """Print the table, and write the figure and the JSON."""
    rows = []
    print(
        f"{'scene':22} {'events':>6} {'engine':>9} {'by hand':>9} {'ratio':>6} {'interpreted':>11}  not needed, there"
    )
    with tempfile.TemporaryDirectory() as folder:
        for name in SCENES:
            race = Race(name, 200.0, machine=True)
            events, apart = race.difference()
            engine_s, hand_s, middle = race.ratio(repeats)
            slow = Race(name, 40.0, machine=False)
            slow.difference()
            slow_engine, slow_hand, _ = slow.ratio(max(3, repeats // 4))
            extra = left_out(name, folder)
            rows.append({
                "scene": name, "events": events, "apart": apart, "engine_s": engine_s, "hand_s": hand_s,
                "ratio": engine_s / hand_s, "median_ratio": middle,
                "interpreted_ratio": slow_engine / slow_hand, **extra,
            })  # fmt: skip
            added = ", ".join(extra["modules"] + extra["channels"]) or "nothing"
            print(
                f"{name:22} {events:6} {1e6 * engine_s / events:6.3f} us {1e6 * hand_s / events:6.3f} us "
                f"{engine_s / hand_s:6.3f} {slow_engine / slow_hand:11.3f}  {added}"
            )
    above = [row["scene"] for row in rows if row["ratio"] > ASKED]
    print(f"CPU per event, compiled; required ratio: {ASKED}; above it: {', '.join(above) or 'none'}")
    figure, axis = plt.subplots(figsize=(7, 5), layout="constrained")
    names = [row["scene"] for row in rows]
    axis.plot([row["ratio"] for row in rows], names, "o", label="compiled")
    axis.plot([row["interpreted_ratio"] for row in rows], names, "k|", ms=12, label="interpreted")
    axis.axvline(ASKED, color="tab:red", lw=1, label=f"asked: {ASKED}")
    axis.axvline(1.0, color="0.5", lw=1)
    axis.grid(axis="x", alpha=0.3)
    axis.set(xlabel="CPU of the engine over that of a kernel written for the scene alone")
    axis.invert_yaxis()
    axis.legend(fontsize=8)
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / "scene_cost.png", dpi=110)
    (RESULTS / "scene_cost.json").write_text(json.dumps({"asked": ASKED, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 25)
