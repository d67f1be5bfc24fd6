"""Claims about the velocity, checked on many seeds of the benchmark, and how often each holds.

``python benchmarks/velocity_seeds.py [FIRST] [LAST] [SECTION ...] [--write]``: seeds FIRST to LAST (default 1 to 6);
sections are `errors`, `sticks`, `scenes`, `windows`, `losses` and `kicks` (default all).  Every line gives mean,
smallest and largest value over the seeds, and how many seeds are within the limit.  ``--write`` puts the sections
`errors` and `losses` into tables of docs/velocity.md.
"""

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pages
from velocity import CASES, Bench, chosen_windows, scenes

import processing
from processing import methods
from processing.record.setting import Setting

RESULTS = Path(__file__).resolve().parent / "results"
RMS = {"7.67 um, no jitter": 0.07, "7.67 um + 30 us": 0.07, "50 um + 30 us": 0.22}
LARGEST = {"7.67 um, no jitter": 1.8, "7.67 um + 30 us": 1.8, "50 um + 30 us": 5.0}
KICKS = (0.02, 0.05, 0.1)  # m/s
# Lost counts and the samples over which they are lost: the least share that is to be found.
LOST = {
    (10, 1): 0.996, (-10, 1): 0.996, (40, 1): 0.996, (12, 2): 0.99, (10, 3): 0.98, (10, 5): 0.95, (-10, 5): 0.95,
    (40, 5): 0.99, (-200, 4): 0.99, (7, 1): 0.98, (5, 1): 0.97, (3, 1): 0.0, (5, 3): 0.0, (5, 5): 0.0,
}  # fmt: skip

Row = dict[str, float]
Limits = dict[str, tuple[float, float]]


def errors(seed: int) -> tuple[Row, Limits]:
    """Return errors and coverage of `auto` in every case of the benchmark."""
    row: Row = {}
    limits: Limits = {}
    for case, (pitch, jitter) in CASES.items():
        bench = Bench(seed, pitch, jitter)
        for times in ("recorded", "nominal"):
            if times == "nominal" and case != "7.67 um + 30 us":
                continue
            name = case if times == "recorded" else f"{case}, nominal"
            data = bench.series(times)
            motion = methods.estimate("auto", data, Setting())
            row[f"{name}: rms"], row[f"{name}: largest"] = bench.errors(motion.velocity)
            limits[f"{name}: rms"] = (0.0, RMS[case] if times == "recorded" else 0.30)
            limits[f"{name}: largest"] = (0.0, LARGEST[case] if times == "recorded" else 3.2)
            row[f"{name}: sticks missing"] = float(_sticks(bench) - _found(bench, times))
            limits[f"{name}: sticks missing"] = (0.0, 0.0)
            if times == "nominal":
                continue
            error = 1e3 * (motion.velocity - bench.v)
            inside = np.abs(error) <= 2e3 * motion.velocity_errors
            row[f"{name}: coverage"] = float(inside.mean())
            row[f"{name}: coverage near re-sticks"] = float(inside[bench.near].mean())
            row[f"{name}: rms near re-sticks"] = float(np.sqrt(np.mean(error[bench.near] ** 2)))
            row[f"{name}: rms in sticks"] = float(np.sqrt(np.mean(error[bench.stuck] ** 2)))
            limits[f"{name}: coverage"] = (0.93, 0.97)
            limits[f"{name}: coverage near re-sticks"] = (0.90, 1.0)
            limits[f"{name}: rms near re-sticks"] = (0.0, 0.4)
            limits[f"{name}: rms in sticks"] = (0.0, 0.02)
            own = row[f"{name}: rms"]
            for method, setting, factor in (("fd", Setting(), 45.0), ("sg", Setting(41, 4), 7.0)):
                rough = methods.estimate(method, data, setting)
                row[f"{name}: {method} over auto"] = bench.errors(rough.velocity)[0] / own
                limits[f"{name}: {method} over auto"] = (factor, np.inf)
            landings = [corner for corner in motion.corners if corner.what == "land"]
            off = np.array([_off(corner.time + bench.time[0], bench.landings) for corner in landings])
            sd = np.array([corner.sd for corner in landings])
            near = np.abs(off) < 2e-3
            row[f"{name}: landings late by, us"] = float(1e6 * np.mean(off[near]))
            row[f"{name}: landings scatter by, us"] = float(1e6 * np.std(off[near]))
            row[f"{name}: standard error of landings, us"] = float(1e6 * np.median(sd))
    return row, limits


def _off(at: float, true: np.ndarray) -> float:
    return float(at - true[np.argmin(np.abs(true - at))])


def _sticks(bench: Bench) -> int:
    """Return how many true sticks of 30 ms or more begin and end in the record, with those cut off by its ends."""
    edges = np.diff(np.concatenate(([0], bench.stuck.astype(np.int8), [0])))
    return int(np.sum(np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1) >= 30))


def _found(bench: Bench, times: str = "recorded", method: str = "auto") -> int:
    return sum(stick.duration > 0.03 for stick in processing.smooth(bench.run(), method, times=times).sticks)


def sticks(seed: int) -> tuple[Row, Limits]:
    """Return how many sticks `auto` misses (negative: adds) in 20 s at many belt speeds, laws 3, 5 and 6."""
    row: Row = {}
    for law in (3, 5, 6):
        for speed in (0.1, 0.15, 0.2, 0.25, 0.3):
            bench = Bench(seed, 7.67e-6, 30e-6, 20.0, **{"friction.law": law, "belt.speed": speed})
            row[f"law {law}, belt {speed} m/s: sticks missing"] = float(_sticks(bench) - _found(bench))
    return row, dict.fromkeys(row, (0.0, 0.0))


def against_rts(seed: int) -> tuple[Row, Limits]:
    """Return the error of `auto` divided by that of `rts` in many scenes."""
    found = scenes(seed)
    row = {name: ratio for name, (_, _, ratio) in found.items()}
    limits = dict.fromkeys(row, (0.0, 1.03))
    row |= {f"{name}: rms of rts": rms for name, (_, rms, _) in found.items()}
    row |= {f"{name}: segment chosen": float(method == "segment") for name, (method, _, _) in found.items()}
    return row, limits


def window(seed: int) -> tuple[Row, Limits]:
    """Return the error of `sg` with the window it chooses divided by that with the best one."""
    row = chosen_windows(seed)
    return row, dict.fromkeys(row, (0.0, 1.08))


def losses(seed: int) -> tuple[Row, Limits]:
    """Return recall of lost counts at random places, correct sizes away from switching times, and false detections."""
    row: Row = {}
    limits: Limits = {}
    bench = Bench(seed, 7.67e-6, 30e-6)
    for size, width in LOST:
        rng = np.random.default_rng(seed)
        at = np.linspace(150, 59_400, 150).astype(int) + rng.integers(0, 300, 150)
        lost = sum(size * np.clip((np.arange(60_000) - k + 1) / width, 0, 1) for k in at)
        count = np.floor(bench.x / bench.pitch + lost).astype(np.int64)
        seen = processing.smooth(bench.run(count), "fd").losses
        found = [min(seen, key=lambda loss, k=k: abs(loss.first - k), default=None) for k in at]
        hit = np.array([own is not None and abs(own.first - k) <= 6 for own, k in zip(found, at, strict=True)])
        clear = np.array([np.abs(bench.landings - bench.time[k]).min() > 0.03 for k in at])
        sized = np.array([own is not None and abs(own.counts - size) <= 1 for own in found])
        name = f"{size} counts over {width}"
        row[f"{name}: recall"], limits[f"{name}: recall"] = float(hit.mean()), (LOST[size, width], 1.0)
        if hit.mean() > 0.1:  # of few found the share says nothing
            row[f"{name}: size right"] = float(sized[hit & clear].mean())
            limits[f"{name}: size right"] = (0.95, 1.0)
        row[f"{name}: false"], limits[f"{name}: false"] = float(len(seen) - hit.sum()), (0.0, 0.0)
    clean = [Bench(100 * seed + k, pitch, 30e-6) for k in range(5) for pitch in (7.67e-6, 50e-6)]
    row["false in 10 clean minutes"] = float(sum(len(processing.smooth(own.run(), "fd").losses) for own in clean))
    limits["false in 10 clean minutes"] = (0.0, 0.0)
    return row, limits


def kicked(seed: int) -> tuple[Row, Limits]:
    """Return detected belt joint kicks, false detections, and the error divided by that of `rts`."""
    row: Row = {}
    limits: Limits = {}
    for kick in KICKS:
        bench = Bench(seed, 7.67e-6, 30e-6, 60.0, **{"joint.kick": kick})
        data = bench.series()
        seen = np.array([bench.time[own.sample] for own in processing.smooth(bench.run(), "fd").kicks])
        hit = [bool(seen.size) and np.abs(seen - at).min() < 4e-3 for at in bench.kicks]
        true = [np.abs(bench.kicks - at).min() < 4e-3 for at in seen] if bench.kicks.size else []
        row[f"{1e3 * kick:g} mm/s: recall"] = float(np.mean(hit))
        row[f"{1e3 * kick:g} mm/s: false"] = float(len(true) - np.sum(true))
        auto, rts = (methods.estimate(name, data, Setting()) for name in ("auto", "rts"))
        row[f"{1e3 * kick:g} mm/s: auto over rts"] = bench.errors(auto.velocity)[0] / bench.errors(rts.velocity)[0]
        limits[f"{1e3 * kick:g} mm/s: auto over rts"] = (0.0, 1.03)
    return row, limits


SECTIONS: dict[str, Callable[[int], tuple[Row, Limits]]] = {
    "errors": errors,
    "sticks": sticks,
    "scenes": against_rts,
    "windows": window,
    "losses": losses,
    "kicks": kicked,
}


def span(rows: list[Row], key: str, form: str = ".3f") -> str:
    """Return mean, and in brackets least and largest, of one result over the seeds; "" where no seed has it."""
    values = np.array([row[key] for row in rows if key in row])
    return f"{values.mean():{form}} ({values.min():{form}} to {values.max():{form}})" if values.size else ""


def error_rows(rows: list[Row]) -> dict[str, list[str]]:
    """Return the rows of the table of errors: a column for each case."""
    quantities = {
        "rms, mm/s": ("rms", ".3f"),
        "largest, mm/s": ("largest", ".2f"),
        "rms within 10 ms of a landing, mm/s": ("rms near re-sticks", ".2f"),
        "rms in sticks, mm/s": ("rms in sticks", ".4f"),
        "covered by two standard errors": ("coverage", ".3f"),
        "covered within 10 ms of a landing": ("coverage near re-sticks", ".3f"),
    }
    cases = [*CASES, "7.67 um + 30 us, nominal"]
    return {
        named: [span(rows, f"{case}: {key}", form) or "-" for case in cases]
        for named, (key, form) in quantities.items()
    }


def loss_rows(rows: list[Row]) -> dict[str, list[str]]:
    """Return the rows of the table of lost counts: share found, sizes right, false ones."""
    found = {}
    for size, width in LOST:
        name = f"{size} counts over {width}"
        sized = [row[f"{name}: size right"] for row in rows if f"{name}: size right" in row]
        found[f"{size} at once" if width == 1 else f"{size} over {width} samples"] = [
            f"{np.mean([row[f'{name}: recall'] for row in rows]):.3f}",
            f"{np.mean(sized):.3f}" if sized else "-",
            f"{sum(row[f'{name}: false'] for row in rows):.0f}",
        ]
    return found


TABLES: dict[str, Callable[[list[Row]], dict[str, list[str]]]] = {
    "errors": error_rows,
    "losses": loss_rows,
}


def main(seeds: Iterable[int], names: list[str], write: bool) -> None:
    """Print the results of the sections given, with the seeds outside their limits, and write the JSON."""
    seeds = list(seeds)
    RESULTS.mkdir(exist_ok=True)
    for name in names:
        rows = []
        limits: Limits = {}
        for seed in seeds:
            row, limits = SECTIONS[name](seed)
            rows.append(row)
        print(f"\n{name}, seeds {seeds[0]} to {seeds[-1]}: mean, least, largest", flush=True)
        for key in dict.fromkeys(key for row in rows for key in row):
            values = np.array([row.get(key, np.nan) for row in rows])
            line = f"  {key:48} {np.nanmean(values):9.4g} {np.nanmin(values):9.4g} {np.nanmax(values):9.4g}"
            if key in limits:
                low, high = limits[key]
                out = [seed for seed, value in zip(seeds, values, strict=True) if value < low or value > high]
                line += f"   {len(seeds) - len(out)} of {len(seeds)} in {low:g}..{high:g}"
                line += f", not {' '.join(map(str, out))}" if out else ""
            print(line, flush=True)
        if write and name in TABLES:
            pages.write("velocity.md", f"velocity_seeds {name}", TABLES[name](rows))
        (RESULTS / f"velocity-{name}.json").write_text(json.dumps({"seeds": seeds, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    words, written = pages.asked()
    first, last = (int(words[k]) if len(words) > k else default for k, default in ((0, 1), (1, 6)))
    main(range(first, last + 1), words[2:] or list(SECTIONS), written)
