"""Velocity compared with the exact motion: error and run time of every method and of other packages.

``python benchmarks/velocity.py [SEEDS] [SAMPLES] [--write]``: the bench is law 5 in SI units for 60 s at 1 kHz (scene
`rig`, belt running from the start), counts = floor(x/pitch), sample times with 30 us of jitter recorded to 1 us, for
SEEDS seeds (default 2; `velocity_seeds.py` uses more); SAMPLES (default 2e6) is the length of the record that is
smoothed in chunks.  Errors are root mean square and largest error of the velocity, mm/s.  CPU time is that of one
process, without compilation, best of a few runs.  The parameters of other packages are tuned with the exact motion,
which no user can do; packages not installed (dependency group `bench`) are listed.  ``--write`` puts the case of
7.67 um with jitter and the costs into docs/velocity.md.
"""

import json
import tempfile
import time as clock
import warnings
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import h5py
import matplotlib as mpl
import numpy as np
import pages

mpl.use("Agg")
import matplotlib.pyplot as plt

import processing
import rig_sim
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from processing import methods, smoothing, stage
from processing import methods as windows
from processing.kalman import white_jerk
from processing.polynomial import savgol
from processing.polynomial.even import coefficients
from processing.record import series
from processing.record.setting import Setting
from rig_sim.motion.play import ScenePlayer
from stickslip.compute.arrays import pieces
from stickslip.units import Measured

RESULTS = Path(__file__).resolve().parent / "results"
WINDOWS = (5, 21, 41, 101, 301, 1001, 1501, 3001)  # of Savitzky-Golay, order 4: their speed
COEFFICIENTS = ((21, 4), (41, 4), (41, 7), (301, 4), (301, 7), (1001, 5), (1001, 20), (3001, 4), (3001, 7), (3001, 20))
SLOW_S = 1.0  # another package that takes longer is timed once
PAGE_CASE = "7.67 um + 30 us"
CASES = {"7.67 um, no jitter": (7.67e-6, 0.0), "7.67 um + 30 us": (7.67e-6, 30e-6), "50 um + 30 us": (50e-6, 30e-6)}
SCENES: dict[str, dict[str, object]] = {
    **{f"law {law}": {"friction.law": law} for law in range(1, 7)},
    "Coulomb, break-away at 1.3 Fs": {"friction.law": 1, "friction.static": 1.3},
    "belt ripple of 2 mm/s": {"belt.ripple": 2e-3, "belt.ripple_hz": 3.0},
    "belt ripple of 10 mm/s": {"belt.ripple": 1e-2, "belt.ripple_hz": 3.0},
    "joint kicks of 20 mm/s": {"joint.kick": 0.02},
    "one long stick": {"belt.speed": 0.0005},
}


class Bench:
    """An exact motion, and the encoder record of it."""

    def __init__(
        self, seed: int, pitch: float, jitter: float, duration: float = 60.0, rate: float = 1000.0, **changes: object
    ) -> None:
        scene = rig_sim.scene("rig", **({"seed": seed, "belt.start": 0.0} | changes))
        rng = np.random.default_rng(1000 + seed)
        n = int(duration * rate)
        instants = np.arange(1, n + 1) * (1 / rate) + jitter * rng.standard_normal(n)
        motion = ScenePlayer(scene)
        motion.events = []
        path = motion.follow(instants)
        self.x, self.v = path.nodes.x[path.samples], path.nodes.v[path.samples]
        self.time = np.round(instants * 1e6) * 1e-6
        self.grid, self.rate = np.arange(1, n + 1) * (1 / rate), rate
        self.count = np.floor(self.x / pitch).astype(np.int64)
        self.pitch = pitch
        self.landings = np.array([event.t for event in motion.events if event.kind.endswith("S")])
        onsets = np.array([event.t for event in motion.events if event.kind.startswith("S")])
        self.kicks = np.array([event.t for event in motion.events if event.kind == "kick"])
        landed, left = (np.searchsorted(at, instants) for at in (self.landings, onsets))
        self.stuck = np.r_[-np.inf, self.landings][landed] > np.r_[-np.inf, onsets][left]
        self.near = np.zeros(n, bool)
        for landing in self.landings:
            self.near |= np.abs(instants - landing) < 0.01

    def run(self, count: np.ndarray | None = None) -> Recording:
        """Return the record in the form that is written to a run file."""
        count = self.count if count is None else count
        rig = Rig(metres_per_count=Measured(self.pitch))
        return Recording(
            title="bench", started="2026-01-01T00:00:00+00:00", ended="2026-01-01T00:01:00+00:00",
            rate_hz=self.rate, rig=rig, time=self.time - self.time[0], position=count * self.pitch, count=count,
        )  # fmt: skip

    def series(self, times: str = "recorded", count: np.ndarray | None = None) -> series.Series:
        """Return the record in the form that the smoothers take."""
        count = self.count if count is None else count
        time = self.time if times == "recorded" else self.grid
        steps = np.diff(time)
        return series.Series(
            time=time - time[0], position=(count - count[0]) * self.pitch, origin=0.0, pitch=self.pitch,
            interval=float(np.median(steps)), pieces=pieces(time, np.zeros(time.size, np.int64), 1e-3),
        )  # fmt: skip

    def errors(self, v: np.ndarray) -> tuple[float, float]:
        """Return rms and largest error of a velocity, mm/s."""
        error = 1e3 * (v - self.v)
        return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


def timed(function: Callable[[], Any], repeats: int = 5) -> tuple[float, Any]:
    """Return the smallest CPU time of a few runs, s, and the result of the last one."""
    function()
    best = np.inf
    for _ in range(repeats):
        begun = clock.process_time()
        answer = function()
        best = min(best, clock.process_time() - begun)
    return best, answer


def ours(bench: Bench) -> dict[str, tuple[float, float, float]]:
    """Return CPU ms, rms and largest error of each method of this project."""
    found = {}
    asked = [("fd", "nominal", Setting()), ("fd", "recorded", Setting()), ("sg", "nominal", Setting(41, 4))]
    asked += [("sg", "recorded", Setting(31, 4)), ("sg", "recorded", Setting())]
    asked += [(name, "recorded", Setting()) for name in ("rts", "segment", "auto")] + [("auto", "nominal", Setting())]
    for method, times, setting in asked:
        data = bench.series(times)
        cpu, motion = timed(lambda m=method, d=data, s=setting: methods.estimate(m, d, s))
        window = f" {setting.window},{setting.order}" if setting.window else " auto" if method == "sg" else ""
        found[f"{method}{window}, {times}"] = (1e3 * cpu, *bench.errors(motion.velocity))
    return found


def peers(bench: Bench) -> tuple[dict[str, tuple[float, float, float]], list[str]]:
    """Return the same for other packages, each at the best of several settings, and the packages not installed."""
    x, t, h = bench.count * bench.pitch, bench.time, 1e-3
    found: dict[str, tuple[float, float, float]] = {}
    absent = []

    def best(name: str, runs: list[Callable[[], np.ndarray]]) -> None:
        tried = []
        for run in runs:
            begun = clock.process_time()
            v = run()
            tried.append((*bench.errors(v), clock.process_time() - begun, run))
        rms, largest, cpu, chosen = min(tried, key=lambda one: one[0])
        found[name] = (1e3 * (cpu if cpu > SLOW_S else timed(chosen, 1)[0]), rms, largest)

    from scipy.interpolate import UnivariateSpline
    from scipy.signal import savgol_filter

    ladder = [(w, o) for w in (21, 31, 41, 51, 61) for o in (4, 6)]
    best("scipy savgol, nominal", [lambda w=w, o=o: savgol_filter(x, w, o, deriv=1, delta=h) for w, o in ladder])
    weight = np.full(x.size, np.sqrt(12) / bench.pitch)
    smooths = [x.size * share for share in (0.9, 0.98, 1.0)]
    best("scipy spline, recorded", [lambda s=s: UnivariateSpline(t, x, weight, k=5, s=s)(t, 1) for s in smooths])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pn = import_module("pynumdiff")
            best("pynumdiff savgol, nominal", [lambda w=w: pn.savgoldiff(x, h, 4, w, 1)[1] for w in (31, 41, 51)])
            best("pynumdiff butter, nominal", [lambda f=f: pn.butterdiff(x, h, 3, f)[1] for f in (0.04, 0.06, 0.09)])
            runs = [lambda q=q: pn.rtsdiff(x, t, 3, q, False)[1] for q in (13.0, 14.5)]
            best("pynumdiff rts, recorded", runs)
    except ImportError:
        absent.append("pynumdiff")
    try:
        we = import_module("whittaker_eilers")
        values = x.tolist()

        def whittaker(power: float) -> np.ndarray:
            smoothed = we.WhittakerSmoother(lmbda=10.0**power, order=3, data_length=x.size).smooth(values)
            return np.gradient(np.array(smoothed), h)

        best("whittaker-eilers, nominal", [lambda p=p: whittaker(p) for p in (3.0, 4.0, 5.0, 6.0)])
    except ImportError:
        absent.append("whittaker-eilers")
    try:
        dv = import_module("derivative")
        few = slice(0, x.size // 10)  # one polynomial fit per sample: a tenth of the record suffices

        def derivative() -> np.ndarray:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return np.asarray(dv.SavitzkyGolay(order=4, left=0.0155, right=0.0155).d(x[few], t[few]))

        cpu, v = timed(derivative, 1)
        error = 1e3 * (v - bench.v[few])
        row = (1e4 * cpu, float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()))
        found["derivative SavitzkyGolay, recorded"] = row
    except ImportError:
        absent.append("derivative")
    return found, absent


def claims(bench: Bench) -> dict[str, float]:
    """Return further results of auto: coverage, switching times, sticks."""
    motion = methods.estimate("auto", bench.series(), Setting())
    inside = np.abs(motion.velocity - bench.v) <= 2 * motion.velocity_errors
    error = 1e3 * (motion.velocity - bench.v)
    return {
        "coverage": float(inside.mean()), "coverage near re-sticks": float(inside[bench.near].mean()),
        "rms near re-sticks": float(np.sqrt(np.mean(error[bench.near] ** 2))),
        "rms in sticks": float(np.sqrt(np.mean(error[bench.stuck] ** 2))),
    }  # fmt: skip


def scenes(seed: int) -> dict[str, tuple[str, float, float]]:
    """Return the method that auto chose and its rms error divided by that of rts, for various scenes."""
    made = {name: Bench(seed, 7.67e-6, 30e-6, 30.0, **changes) for name, changes in SCENES.items()}
    found = {}
    for name, bench in made.items():
        data = bench.series()
        found[name] = _against_rts(bench, data)
    bench = made["law 5"]
    for gap in (20, 50):
        kept = np.ones(bench.v.size, bool)
        for at in range(1500, kept.size, 2903):
            kept[at : at + gap] = False
        cut = Bench(seed, 7.67e-6, 30e-6, 30.0)
        for name in ("x", "v", "time", "grid", "count"):
            setattr(cut, name, getattr(bench, name)[kept])
        found[f"gaps of {gap} ms"] = _against_rts(cut, cut.series())
    swing = bench.series()
    time = swing.time
    true = 0.1 * np.sin(6 * time)
    counted = np.floor(true / bench.pitch)
    swing = replace(swing, position=(counted - counted[0]) * bench.pitch)
    bench.v = 0.6 * np.cos(6 * time)
    found["pure sine"] = _against_rts(bench, swing)
    return found


def _against_rts(bench: Bench, data: series.Series) -> tuple[str, float, float]:
    motion = methods.estimate("auto", data, Setting())
    rms = bench.errors(methods.estimate("rts", data, Setting()).velocity)[0]
    return motion.method, rms, bench.errors(motion.velocity)[0] / rms


def chosen_windows(seed: int) -> dict[str, float]:
    """Return the error with the chosen window divided by that with the best window, found with the exact motion."""
    found = {}
    for pitch in (1e-6, 7.67e-6, 50e-6, 200e-6):
        for jitter in (0.0, 30e-6):
            bench = Bench(seed, pitch, jitter, 30.0)
            data = bench.series()
            choice = windows.choose_window(data)
            ladder = sorted({max(int(choice.window * factor) | 1, 7) for factor in np.geomspace(0.5, 1.7, 11)})
            tried = [Setting(w, o) for o in (2, 4, 6) for w in ladder if w > o]
            errors = [bench.errors(savgol.fit(data.time, data.position, s.window, s.order)[0][1])[0] for s in tried]
            own = bench.errors(savgol.fit(data.time, data.position, choice.window, choice.order)[0][1])[0]
            found[f"{1e6 * pitch:g} um, jitter {1e6 * jitter:g} us"] = own / min(errors)
    return found


def speed(bench: Bench) -> dict[str, float]:
    """Return Msamples/s of x, v and a together: sg by window and three calls of scipy, rts; and the ms of segment."""
    from scipy.signal import savgol_filter

    even = bench.series("nominal")
    found = {}
    for window in WINDOWS:
        cpu, _ = timed(lambda w=window: savgol.fit(even.time, even.position, w, 4), 20)
        peer, _ = timed(lambda w=window: [savgol_filter(even.position, w, 4, deriv=d) for d in range(3)], 3)
        found[f"sg {window},4"] = even.time.size / cpu / 1e6
        found[f"sg {window},4 over scipy"] = peer / cpu
    data = bench.series()
    noise = white_jerk.fit(data)
    reach, motion = white_jerk.samples_to_fade(noise.rho(data.interval)), np.empty((6, data.time.size))
    asked = data.time, data.position, noise, white_jerk.BLOCK, reach, motion
    found["rts, noise known"] = data.time.size / timed(lambda: white_jerk.smooth_piece(*asked), 20)[0] / 1e6
    found["rts, ms in all"] = 1e3 * timed(lambda: methods.estimate("rts", data, Setting()), 10)[0]
    found["segment, ms in all"] = 1e3 * timed(lambda: methods.estimate("segment", data, Setting()), 10)[0]
    found["auto, ms in all"] = 1e3 * timed(lambda: methods.estimate("auto", data, Setting()), 10)[0]
    return found


def exactness() -> dict[str, tuple[float, float]]:
    """Return by window and order the largest error of our coefficients and of scipy's, each over the largest weight.

    Ours are those of three places of the window, scipy's those of its middle; both of position, velocity and
    acceleration, against rational arithmetic.
    """
    from scipy.signal import savgol_coeffs

    found = {}
    for window, order in COEFFICIENTS:
        half = window // 2
        nodes = [-half, -half // 3, 0, half // 2, half]
        ours, scipys = 0.0, 0.0
        for at in (0, half // 3, half):
            made = coefficients(window, order, at)
            for d in range(3):
                exact = np.array([float(_gram_exactly(window, order, Fraction(at), d, j)) for j in nodes])
                places = np.array(nodes) + half
                ours = max(ours, np.abs(made[d][places] - exact).max() / np.abs(made[d]).max())
                if at == 0:
                    peer = savgol_coeffs(window, order, deriv=d, use="dot")
                    scipys = max(scipys, np.abs(peer[places] - exact).max() / np.abs(made[d]).max())
        found[f"{window},{order}"] = float(ours), float(scipys)
    return found


def _gram_exactly(window: int, order: int, s: Any, d: int, j: int) -> Any:
    p, p_last, g = 1, 0, window
    e, e_last = [1, 0, 0], [0, 0, 0]
    total = type(s)(e[d] * p, g)
    for k in range(1, order + 1):
        b_last = type(s)((k - 1) ** 2 * (window**2 - (k - 1) ** 2), 4 * (4 * (k - 1) ** 2 - 1)) if k > 1 else 0
        p, p_last = j * p - b_last * p_last, p
        new = [s * e[0], e[0] + s * e[1], 2 * e[1] + s * e[2]]
        e, e_last = [new[i] - b_last * e_last[i] for i in range(3)], e
        g = g * type(s)(k**2 * (window**2 - k**2), 4 * (4 * k**2 - 1))
        total += e[d] * p / g
    return total


def losses(seed: int) -> dict[str, float]:
    """Return the share of losses detected (10 and 40 counts, over 1 to 5 samples), and the false detections."""
    found: dict[str, float] = {}
    for size, width in ((10, 1), (10, 5), (40, 3)):
        bench = Bench(seed, 7.67e-6, 30e-6)
        rng = np.random.default_rng(seed)
        clear = [k for k in range(100, 59_900, 97) if np.abs(bench.landings - bench.time[k]).min() > 0.03]
        at = np.sort(rng.choice(clear, 40, replace=False))
        lost = sum(size * np.clip((np.arange(60_000) - k + 1) / width, 0, 1) for k in at)
        count = np.floor(bench.x / bench.pitch + lost).astype(np.int64)
        seen = processing.smooth(bench.run(count), "fd").losses
        right = [k for k in at if any(abs(loss.first - k) <= 5 and abs(loss.counts - size) <= 1 for loss in seen)]
        found[f"{size} counts over {width}"] = len(right) / at.size
    found["false in 5 clean minutes"] = sum(
        len(processing.smooth(Bench(seed + k, 7.67e-6, 30e-6).run(), "fd").losses) for k in range(5)
    )
    return found


def long_record(n: int) -> dict[str, float]:
    """Smooth n samples in chunks: return CPU seconds, and CPU seconds of reading and writing alone."""
    bench = Bench(1, 7.67e-6, 30e-6)
    found = {"samples": float(n)}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.h5"
        times = -(-n // bench.time.size)
        run = bench.run()
        long = replace(
            run,
            time=np.concatenate([run.time + 61.0 * k for k in range(times)])[:n],
            position=np.tile(run.position, times)[:n],
            count=np.tile(run.count, times)[:n],
        )
        store.write(path, long)
        del long
        for method, setting in (("sg", (41, 4)), ("rts", ()), ("auto", ())):
            begun = clock.process_time()
            smoothing.smooth_file(path, method, *setting)
            found[f"{method}, CPU s"] = clock.process_time() - begun
            begun = clock.process_time()
            with h5py.File(path, "r", locking=False) as file, h5py.File(Path(folder) / "copy.h5", "w") as copy:
                table = stage.empty(stage.begin(copy.create_group("entry")), n, "m")
                made = file["entry/smooth/kinematics"]
                for at in range(0, n, smoothing.BLOCK):
                    store.load(path, slice(at, at + smoothing.BLOCK))
                    for name in table:
                        table[name][at : at + smoothing.BLOCK] = made[name][at : at + smoothing.BLOCK]
            found[f"{method}, read + write alone, CPU s"] = clock.process_time() - begun
            alone, whole = found[f"{method}, read + write alone, CPU s"], found[f"{method}, CPU s"]
            found[f"{method}, share of the speed of read + write"] = alone / whole
    return found


def picture(bench: Bench, table: dict[str, tuple[float, float, float]], target: Path) -> None:
    """Draw a landing as estimated by each method, and error against run time."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    landing = bench.landings[3]
    own = np.abs(bench.time - landing) < 0.04
    at = 1e3 * (bench.time[own] - landing)
    data = bench.series()
    for method, setting, style in (
        ("fd", Setting(), {"color": "0.75", "lw": 0.7}),
        ("sg", Setting(41, 4), {"color": "C1"}),
        ("auto", Setting(), {"color": "C0", "lw": 2}),
    ):
        motion = methods.estimate(method, data, setting)
        left.plot(at, 1e3 * motion.velocity[own], label=method, **style)
    left.plot(at, 1e3 * bench.v[own], "k:", lw=1, label="truth")
    left.set(xlabel="time from the landing, ms", ylabel="velocity, mm/s", ylim=(120, 240), title="a landing")
    left.legend()
    for k, (name, (cpu, rms, _)) in enumerate(sorted(table.items(), key=lambda item: -item[1][1])):
        mine = name.split()[0].rstrip(",") in methods.METHODS
        right.loglog(cpu, rms, "osD^v<>pP*Xhd8H"[k % 15], color=f"C{k % 10}", ms=9 if mine else 5, label=name)
    figure.legend(*right.get_legend_handles_labels(), loc="outside right center", fontsize=7)
    right.set(
        xlabel="CPU, ms for 60 000 samples", ylabel="rms error, mm/s", title="7.67 um, 30 us of jitter; large: ours"
    )
    right.grid(alpha=0.3, which="both")
    target.parent.mkdir(exist_ok=True)
    figure.savefig(target, dpi=110)


def method_rows(table: dict[str, list[float]]) -> dict[str, list[str]]:
    """Return the rows of the table of methods: CPU time over that of `auto`, rms and largest error."""
    auto = table["auto, recorded"][0]
    found = {}
    for name, (cpu, rms, worst) in table.items():
        method, _, rest = name.removesuffix(", recorded").partition(" ")
        own = method.rstrip(",") in methods.METHODS
        named = f"`{method.rstrip(',')}`{',' * method.endswith(',')} {rest}".strip() if own else f"{method} {rest}"
        found[named] = [pages.significant(cpu / auto), pages.significant(rms), pages.significant(worst)]
    return found


def cost_rows(speeds: dict[str, float], long: dict[str, float]) -> dict[str, list[str]]:
    """Return the rows of the table of costs; the first states the processor."""
    samples = long["samples"]
    found = {"processor": [pages.processor()]}
    for method in ("auto", "segment", "rts"):
        found[f"`{method}`, 60,000 samples, in memory"] = [f"{speeds[f'{method}, ms in all']:.0f} ms"]
    for method in ("auto", "rts", "sg"):
        named = f"`{method}`{' 41,4' * (method == 'sg')}"
        found[f"{named}, a million samples, from file to file"] = [f"{1e6 * long[f'{method}, CPU s'] / samples:.1f} s"]
    return found


def main(seeds: int, samples: int, write: bool) -> None:
    """Print the tables, write the figure and the JSON, and with ``write`` the tables of the page."""
    collected: dict[str, Any] = {}
    for case, (pitch, jitter) in CASES.items():
        rows: dict[str, list[tuple[float, float, float]]] = {}
        claimed = []
        for seed in range(1, seeds + 1):
            bench = Bench(seed, pitch, jitter)
            found = ours(bench)
            if seed == 1 and case == PAGE_CASE:
                others, absent = peers(bench)
                if absent:
                    print(f"not installed, omitted: {', '.join(absent)}")
                found |= others
                picture(bench, found, RESULTS / "velocity.png")
            for name, row in found.items():
                rows.setdefault(name, []).append(row)
            claimed.append(claims(bench))
        print(f"\n{case}: CPU ms, rms and largest error of v, mm/s")
        collected[case] = {name: np.mean(row, axis=0).tolist() for name, row in rows.items()}
        for name, (cpu, rms, worst) in collected[case].items():
            print(f"  {name:38} {cpu:9.2f} {rms:9.3f} {worst:9.2f}")
        collected[f"{case}, auto"] = {key: [own[key] for own in claimed] for key in claimed[0]}
        for key, values in collected[f"{case}, auto"].items():
            print(f"  auto: {key:32} " + " ".join(f"{value:.3f}" for value in values))
    collected["auto over rts"] = scenes(1)
    print("\nauto against rts: method, rms of rts, ratio")
    for name, (method, rms, ratio) in collected["auto over rts"].items():
        print(f"  {name:24} {method:8} {rms:8.3f} {ratio:6.3f}")
    sections: dict[str, Callable[[], dict[str, float]]] = {
        "sg --window auto over the best window": lambda: chosen_windows(1),
        "speed": lambda: speed(Bench(1, 7.67e-6, 30e-6)),
        "lost counts": lambda: losses(1),
        "long record": lambda: long_record(samples),
    }
    for name, section in sections.items():
        collected[name] = section()
        print(f"\n{name}")
        for key, value in collected[name].items():
            print(f"  {key:40} {value:12.4g}")
    collected["coefficients"] = exactness()
    print("\nlargest error of the coefficients over the largest weight, and scipy's")
    for key, (own, peer) in collected["coefficients"].items():
        print(f"  {key:40} {own:12.1e} {peer:12.1e}")
    if write:
        pages.write("velocity.md", "velocity methods", method_rows(collected[PAGE_CASE]))
        pages.write("velocity.md", "velocity cost", cost_rows(collected["speed"], collected["long record"]))
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "velocity.json").write_text(json.dumps(collected, indent=1) + "\n")


if __name__ == "__main__":
    words, written = pages.asked()
    main(int(words[0]) if words else 2, int(float(words[1])) if len(words) > 1 else 2_000_000, written)
