"""CPU time of ranking six laws: compiled, by length of the record; on the first call; and compared with scipy.

``python benchmarks/fit_speed.py [--laws 3,5] [--lengths 30,60,120,300,600]``

    warm      CPU seconds of `fitting.rank` (user and system, all threads) on the scene `rig` at 1 kHz with 5 % scatter,
              for a record of each law, compiled and called once before: of the six laws, and of goodness of fit and
              measured curve together (`measure` and `assess` of `fitting.judge.adequacy`)
    first     wall and CPU seconds of the command `fit-friction` with an empty folder for machine code
    scipy     one slip window of law 5: the same residuals, priors and unknowns, from the same start to the same
              minimum, by `solve_ivp` with an event at the landing under `least_squares`, compared with this project's
              minimiser and integrator.  Medians of CPU seconds
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import fitting
import processing
from daq.protocols.request import RecordRequest
from daq.recorder import ports
from daq.recorder.record import record
from daq.runfile import store
from fitting import ranking
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.normal_equations import LeastSquaresProblem
from fitting.model import flow
from fitting.model import problem as starts
from fitting.model.predict import Model, law_task
from fitting.model.problem import Run
from fitting.model.unknowns import Global, PerCycle
from fitting.model.windows import ShootingWindows
from fitting.record import cycles
from fitting.record import motion as frame
from processing.record.kinematics import Kinematics

RESULTS = Path(__file__).resolve().parent / "results"
SCENE = ("scatter.Fs=0.05", "jitter.rms=50e-6", "damper.c=0.01")
SOLVERS = ("RK45", "DOP853", "LSODA")  # solve_ivp's default, and the others that suit a smooth slip
TIGHT = {"rtol": 1e-10, "atol": 1e-13}  # of solve_ivp: its positions good to well below a count


def recorded(law: int, seconds: float, folder: str) -> Path:
    """Record the simulated rig."""
    path = Path(folder) / f"{law}-{seconds:g}.h5"
    if not path.exists():
        url = ports.rig_url("rig", [f"friction.law={law}", "seed=7", *SCENE], False)
        record(RecordRequest(url, path, 1000, seconds))
    return path


def cpu_s(who: int = resource.RUSAGE_SELF) -> float:
    """Return the CPU seconds used so far by this process or by its children."""
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def warm(laws: list[int], lengths: list[float], folder: str) -> list[dict[str, Any]]:
    """Rank records of each length; return a row for each."""
    fitting.rank(processing.smooth(store.load(recorded(5, 10, folder))))
    rows = []
    for seconds in lengths:
        for law in laws:
            kinematics = processing.smooth(store.load(recorded(law, seconds, folder)))
            begun = cpu_s()
            found, assessing = ranked(kinematics)
            fits = cpu_s() - begun - assessing
            rows.append({"law": law, "seconds": seconds, "fits_s": fits, "assess_s": assessing,
                         "set": list(found.laws_in_set)})  # fmt: skip
            print(f"  law {law}, {seconds:4g} s: six laws {fits:6.2f} CPU s, {fits / seconds * 1e3:5.1f} ms/s   "
                  f"goodness of fit and curve {assessing:6.2f} CPU s   set {rows[-1]['set']}", flush=True)  # fmt: skip
    return rows


def ranked(kinematics: Kinematics) -> tuple[fitting.Ranking, float]:
    """Rank one record; also return the CPU seconds of goodness of fit and measured curve."""
    spent, stages = 0.0, {name: getattr(ranking, name) for name in ("measure", "assess")}

    def timed(stage: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        nonlocal spent
        begun = cpu_s()
        found = stage(*arguments, **options)
        spent += cpu_s() - begun
        return found

    for name, stage in stages.items():
        setattr(ranking, name, partial(timed, stage))
    try:
        found = fitting.rank(kinematics)
    finally:
        for name, stage in stages.items():
            setattr(ranking, name, stage)
    return found, spent


def first_call(folder: str) -> dict[str, Any]:
    """Run the command with nothing compiled."""
    path = recorded(5, 30, folder)
    with tempfile.TemporaryDirectory() as empty:
        environment = os.environ | {"NUMBA_CACHE_DIR": empty}
        before, begun = cpu_s(resource.RUSAGE_CHILDREN), clock.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "fitting.cli", str(path), "--report", f"{empty}/report.html"],
            env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        wall, spent = clock.monotonic() - begun, cpu_s(resource.RUSAGE_CHILDREN) - before
    if done.returncode not in (0, 5):
        raise SystemExit(done.stderr)
    said = [line for line in done.stderr.splitlines() if line.startswith("compiling")]
    return {"wall_s": wall, "cpu_s": spent, "said": said}


class OneWindow:
    """The fit of one slip window of law 5, for both minimisers; ``solver`` is solve_ivp's method."""

    def __init__(self, kinematics: Kinematics) -> None:
        self.solver = SOLVERS[0]
        motion = frame.from_kinematics(kinematics, kinematics.recording.rig, None)
        cut = cycles.segment_cycles(motion)
        cycle = next(cycle for cycle in cut.used[2:] if not cycle.overtakes)
        cycle = replace(cycle, stick=(cycle.slip[0], cycle.slip[0]))
        self.windows = ShootingWindows.from_cycles(motion, (cycle,))
        self.index = [Global.K, Global.LOG_F, Global.V_DR, Global.SHAPE, Global.DATUM, Global.DAMPING]
        task = replace(law_task(5, [Run(motion, replace(cut, cycles=cut.used))]), places=tuple(self.index))
        self.model, self.problem = Model(task, self.windows, flow.LONGEST_STEP), task.problem
        problem = task.problem
        self.own = [PerCycle.X_SLIP, PerCycle.V_SLIP, PerCycle.LEVEL]
        self.local = starts.cycle_starts(self.windows, [motion], [cycle], problem.start)
        self.weight = 1 / motion.resolution**2
        sd = np.array([[0.1 * motion.travel, motion.belt_speed, 0.05, 0.05, 1.0, 1.0]])
        self.local_precision = 1 / sd**2
        self.start = np.r_[problem.start[self.index], self.local[0, self.own]]
        shared = problem.start[self.index]
        self.scale = np.r_[np.where(shared == 0, 0.01, np.abs(shared)), sd[0, self.own]]

    def ours(self) -> tuple[np.ndarray, float, float]:
        """Return unknowns, cost and CPU seconds of this project's minimiser."""
        s = self.problem
        begun = clock.process_time()
        problem = LeastSquaresProblem(
            evaluate=self.model.evaluate,
            rows=self.windows.rows, weights=np.array([self.weight]),
            lower=s.lower[self.index], upper=s.upper[self.index],
            prior=s.prior[self.index], precision=s.precision[self.index],
            local_prior=self.local, local_precision=self.local_precision,
        )  # fmt: skip
        found = levenberg_marquardt.minimise(problem, s.start[self.index], self.local, max_steps=200, tolerance=1e-9)
        spent = clock.process_time() - begun
        if found is None:
            raise SystemExit("the flow cannot be followed from the start")
        return np.r_[found.u, found.local[0, self.own]], found.cost, spent

    def residuals(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the same residuals by scipy: measured positions first, then the priors."""
        k, log_f, belt, gamma, datum, damping, x, v, level = unknowns
        force = math.exp(log_f + level)
        time = self.windows.time

        def rates(_: float, state: np.ndarray) -> list[float]:
            x, v = state
            return [v, force / (1 + gamma * (belt - v)) - k * (x - datum) - damping * v]

        def lands(_: float, state: np.ndarray) -> float:
            return state[1] - belt

        lands.terminal, lands.direction = True, 1.0  # type: ignore[attr-defined]
        slip = solve_ivp(rates, (time[0], time[-1]), [x, v], self.solver, time, events=lands, **TIGHT)
        model = np.empty(time.size)
        model[: slip.t.size] = slip.y[0]
        if slip.t.size < time.size:
            model[slip.t.size :] = slip.y_events[0][0][0] + belt * (time[slip.t.size :] - slip.t_events[0][0])
        s = self.problem
        u_prior, u_precision = s.prior[self.index], s.precision[self.index]
        return np.r_[
            math.sqrt(self.weight) * (model - self.windows.position),
            np.sqrt(u_precision) * (unknowns[: u_prior.size] - u_prior),
            np.sqrt(self.local_precision[0, self.own]) * (unknowns[u_prior.size :] - self.local[0, self.own]),
        ]

    def scipys(self) -> tuple[np.ndarray, float, float, int]:
        """Return unknowns, cost, CPU seconds and number of shots of `least_squares`."""
        shots = 0

        def counted(unknowns: np.ndarray) -> np.ndarray:
            nonlocal shots
            shots += 1
            return self.residuals(unknowns)

        s = self.problem
        lower = np.r_[s.lower[self.index], np.full(3, -np.inf)]
        upper = np.r_[s.upper[self.index], np.full(3, np.inf)]
        begun = clock.process_time()
        found = least_squares(counted, np.clip(self.start, lower + 1e-12, upper), bounds=(lower, upper),
                              x_scale=self.scale, ftol=1e-9, xtol=1e-12, gtol=1e-12, max_nfev=200)  # fmt: skip
        return found.x, float(found.cost), clock.process_time() - begun, shots


def against_scipy(folder: str) -> dict[str, Any]:
    """Fit one window with both minimisers."""
    one = OneWindow(processing.smooth(store.load(recorded(5, 30, folder))))
    one.ours()
    mine, cost, _ = one.ours()
    spent = float(np.median([one.ours()[2] for _ in range(21)]))
    rows = []
    for one.solver in SOLVERS:
        theirs = [one.scipys() for _ in range(3)]
        found, other, _, shots = theirs[0]
        seconds = float(np.median([run[2] for run in theirs]))
        gap = float(np.max(np.abs(mine - found) / one.scale))
        rows.append({"solver": one.solver, "scipy_s": seconds, "ratio": seconds / spent, "shots": shots,
                     "scipy_cost": other, "largest_difference": gap})  # fmt: skip
    return {"ours_s": spent, "cost": cost, "samples": one.windows.time.size, "scipy": rows}


def main() -> None:
    """Measure, print and store the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--laws", default="1,2,3,4,5,6")
    parser.add_argument("--lengths", default="30,60,120,300,600", help="seconds")
    chosen = parser.parse_args()
    laws = [int(law) for law in chosen.laws.split(",")]
    lengths = [float(length) for length in chosen.lengths.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        print("six laws ranked, warm:")
        rows = warm(laws, lengths, folder)
        for seconds in lengths:
            own = [row for row in rows if row["seconds"] == seconds]
            fits = [row["fits_s"] / seconds * 1e3 for row in own]
            rest = [row["assess_s"] / seconds * 30 for row in own]
            print(f"{seconds:5g} s: six laws {np.mean(fits):5.1f} ms/s on average, {max(fits):5.1f} at most; goodness"
                  f" of fit and curve {np.mean(rest):5.2f} CPU s per 30 s, {max(rest):5.2f} at most")  # fmt: skip
        cold = first_call(folder)
        print(f"first call with nothing compiled: {cold['cpu_s']:.1f} CPU s, {cold['wall_s']:.1f} s; output:")
        for line in cold["said"]:
            print(f"    {line}")
        one = against_scipy(folder)
        print(f"one slip window ({one['samples']} samples): ours {1e3 * one['ours_s']:.2f} ms, cost {one['cost']:.6g}")
        for row in one["scipy"]:
            print(
                f"    scipy, {row['solver']}: {row['scipy_s']:.2f} s ({row['shots']} shots): {row['ratio']:.0f} times; "
                f"cost {row['scipy_cost']:.6g}, unknowns alike to {row['largest_difference']:.1e} of their scale"
            )
    RESULTS.mkdir(exist_ok=True)
    document = {"warm": rows, "first": cold, "scipy": one}
    (RESULTS / "fit_speed.json").write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
