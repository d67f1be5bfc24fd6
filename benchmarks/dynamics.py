"""Speed of the map of two masses against general tools, in one run.

``python benchmarks/dynamics.py [EVENTS]`` (default 200 of the slow peers; ``sweep`` instead: the diagram alone): CPU
time per event and error against the exact map, on the thesis's two masses at V = 0.1 with starts all over the interval
of d, of

    exact, fine, coarse     rig_sim.systems.stick, compiled
    scipy                   oracles.two_masses: DOP853 between located events, rtol 1e-6
    pynamicalsys            RK45 of the equations with sign(w) replaced by tanh(w/width), compiled by numba

then the time of a diagram of both attractors at 400 velocities: in this process, in two, and by a dask cluster of two
workers on this machine.  Other work on the machine lengthens these times; the CPU times of all processes, their imports
among them, and the load are stated too.  pynamicalsys knows neither stick nor events:
its error is that of x2 - x1 at the instant of the next global stick.  Errors are quantiles: beside a jump of the map
any method may fall on the other side.
"""

import json
import math
import os
import platform
import sys
import time
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from rig_sim.analyses.sweep import sweep
from rig_sim.flow.flow import Flow
from rig_sim.flow.two_mass import TwoMassFlow, slip_start
from rig_sim.results.scene_systems import SweptScene, find_two_mass_attractors
from rig_sim.scenes.scene import scene
from rig_sim.systems.stick import COARSE, EXACT, FINE, StickMap
from stickslip.compute.workers import workers

RESULTS = Path(__file__).resolve().parent / "results"
FLOW = TwoMassFlow(Flow(v_belt=0.1))
STARTS = np.linspace(-0.67, 0.67, 20_001)
REPEATS = 5
WIDTH = 1e-3  # of tanh(w/width): the smallest with which the peer is not slower still
VALUES = np.linspace(0.08, 0.2, 400).tolist()


def main(argument: str) -> None:
    result = {"cpus": os.cpu_count(), "machine": platform.processor() or platform.machine()}
    name = "dynamics_sweep.json"
    if argument != "sweep":
        result |= map_speed(int(argument))
        name = "dynamics.json"
    result["sweep"] = sweep_speed()
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / name).write_text(json.dumps(result, indent=1))


def map_speed(events):
    """Print and return what an event costs by each method."""
    # Not above: every process of a sweep imports this file, and with it would import scipy, 0.4 s.
    from oracles.two_masses import next_stick

    rows = []
    exact = StickMap(FLOW)
    expected = exact.images(STARTS)
    for name, precision in (("exact", EXACT), ("fine", FINE), ("coarse", COARSE)):
        f = StickMap(FLOW, precision)
        f.images(STARTS[:2])
        cost = min(cpu_of(partial(f.images, STARTS))[0] for _ in range(REPEATS)) / len(STARTS)
        rows.append(
            row(name, f"degree {precision[0]}, tolerance {precision[1]:.0e}", cost, f.images(STARTS) - expected)
        )
    few = STARTS[:: len(STARTS) // events]
    cost, found = cpu_of(lambda: np.array([next_stick(FLOW, float(d), rtol=1e-6)[0] for d in few]))
    rows.append(row("scipy", "DOP853, rtol 1e-06", cost / len(few), found - exact.images(few)))
    smooth = smoothed()
    if smooth is not None:
        events_of = [exact.event(float(d)) for d in few]
        smooth(float(few[0]), 1.0)
        cost, found = cpu_of(
            lambda: np.array([smooth(float(d), event.duration) for d, event in zip(few, events_of, strict=True)])
        )
        rows.append(row("pynamicalsys", f"RK45, tanh(w/{WIDTH:g})", cost / len(few), found - exact.images(few)))
    for entry in rows:
        print(
            f"{entry['method']:13} {entry['setting']:32} {entry['per_second']:10.0f} events/s  "
            f"error {entry['error_median']:.1e} (99 %: {entry['error_99']:.1e})"
        )
    fast = {entry["method"]: entry["per_second"] for entry in rows}
    ratios = {peer: fast["fine"] / fast[peer] for peer in ("scipy", "pynamicalsys") if peer in fast}
    for peer, ratio in ratios.items():
        print(f"fine is {ratio:.0f} times as fast as {peer}, coarse {fast['coarse'] / fast[peer]:.0f} times")
    return {"rows": rows, "ratios": ratios}


def sweep_speed():
    """Print and return the times of the diagram by who computes it."""
    find = partial(find_two_mass_attractors, SweptScene(scene("two-mass"), "belt.speed"), "poincare")
    ways = {"one process": (1, False), "two processes": (2, False), "two dask workers": (1, True)}
    if find_spec("distributed") is None:
        print("dask.distributed is not installed: pip install 'stickslip[cluster]'")
        del ways["two dask workers"]
    find(VALUES[0])  # compiles
    found, first = {}, None
    for name, (jobs, dask) in ways.items():
        load, before = os.getloadavg()[0], cpu_of_all()
        with dask_cluster() if dask else nullcontext() as address:
            with workers(jobs, address, join=True) as spread:
                begun = time.perf_counter()
                rows = sweep(find, VALUES, spread=spread)
                wall = time.perf_counter() - begun
        first = first or rows
        serial = found["one process"]["wall_s"] if found else wall
        same = rows == first
        cpu, outcome = cpu_of_all() - before, "the same to the last bit" if same else "DIFFERENT"
        found[name] = {
            "wall_s": wall,
            "cpu_s": cpu,
            "load": load,
            "speedup": serial / wall,
            "same": same,
        }
        print(
            f"{len(VALUES)} velocities, {name:16} {wall:6.1f} s ({serial / wall:.2f} times as fast), "
            f"CPU {cpu:6.1f} s, load before {load:.1f}, {outcome}"
        )
    return found


@contextmanager
def dask_cluster():
    """Start a dask scheduler and two workers of one thread on this machine; yield the address."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def cpu_of_all():
    """Return the CPU time of this process and of those of its children that have ended, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def cpu_of(work):
    begun = time.process_time()
    result = work()
    return time.process_time() - begun, result


def row(method, setting, cost, error):
    size = np.abs(error[np.isfinite(error)])
    return {
        "method": method,
        "setting": setting,
        "us_per_event": 1e6 * cost,
        "per_second": 1.0 / cost,
        "error_median": float(np.median(size)),
        "error_99": float(np.quantile(size, 0.99)),
    }


def smoothed():
    """Return a function (d, duration) -> x2 - x1 by pynamicalsys; None where it is not installed."""
    try:
        from numba import njit
        from pynamicalsys import ContinuousDynamicalSystem
    except ImportError:
        print("pynamicalsys is not installed: pip install --group bench")
        return None

    @njit
    def equations(time, u, parameters):
        v, a, b, gamma, width = parameters
        w1, w2 = u[2] - v, u[3] - v
        F1 = -math.tanh(w1 / width) / (1.0 + gamma * abs(w1))
        F2 = -b * math.tanh(w2 / width) / (1.0 + gamma * abs(w2))
        return np.array([u[2], u[3], F1 - u[0] - a * (u[0] - u[1]), F2 - u[1] - a * (u[1] - u[0])])

    system = ContinuousDynamicalSystem(equations_of_motion=equations, system_dimension=4, number_of_parameters=5)
    system.integrator("rk45", atol=1e-8, rtol=1e-8)
    parameters = [FLOW.mass.v_belt, FLOW.a, FLOW.b, FLOW.mass.gamma, WIDTH]

    def follow(d, duration):
        x1, x2 = slip_start(FLOW, d)
        end = system.evolve_system([x1, x2, FLOW.mass.v_belt, FLOW.mass.v_belt], duration, parameters=parameters)
        return float(end[1] - end[0])

    return follow


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "200")
