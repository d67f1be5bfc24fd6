"""The whole of what the live view computes: no record breaks it, and every sample is told once."""

import json
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as some

from daq.live.analysis import LiveAnalysis
from daq.live.tail import NewSamples

from .motions import pieces, stick_slip


def told(live: LiveAnalysis, whole: NewSamples, size: int) -> np.ndarray:
    return np.concatenate([live.feed(piece) for piece in pieces(whole, size)], axis=1)


def shapes(kind: str, t: np.ndarray, draw: np.random.Generator, size: float) -> np.ndarray:
    if kind == "rest":
        return np.zeros(t.size)
    if kind == "walk":
        return size * np.cumsum(draw.normal(size=t.size))
    if kind == "counts":
        return size * np.round(5 * t + 3 * np.sin(4 * t))
    if kind == "steps":
        return size * np.repeat(draw.normal(size=t.size // 50 + 1), 50)[: t.size]
    if kind == "belt":
        return size * t
    sticks = stick_slip(math.ceil(t.size / 1000), 1000.0)
    return size * np.resize(sticks.x, t.size) + 0.01 * size * draw.normal(size=t.size) ** 5


@settings(max_examples=25, deadline=None)
@given(
    parts=some.lists(some.sampled_from(["rest", "walk", "counts", "steps", "belt", "sticks"]), min_size=1, max_size=4),
    size=some.sampled_from([1e-12, 1e-5, 1.0, 1e9]),
    seed=some.integers(0, 1000),
    piece=some.sampled_from([1, 37, 500, 100_000]),
    gaps=some.booleans(),
)
def test_no_record_breaks_the_analysis(parts: list[str], size: float, seed: int, piece: int, gaps: bool) -> None:
    draw = np.random.default_rng(seed)
    n = 300 if piece == 1 else 4000
    t = np.arange(n * len(parts)) / 1000
    x = np.concatenate([shapes(part, t[:n], draw, size) for part in parts])
    fresh = draw.random(t.size) < (0.003 if gaps else 0)
    if gaps:
        keep = np.repeat(draw.random(t.size // 20) > 0.1, 20)
        t, x, fresh = t[keep], x[keep], fresh[keep]
    live = LiveAnalysis(1000.0)
    live.unit = "m"
    rows = told(live, NewSamples(t, x, fresh), piece)
    assert np.all(np.diff(rows[0]) > 0)
    assert np.isin(rows[0], t).all()
    summary = live.summarise()
    json.dumps(summary, allow_nan=False)
    assert summary["cycles"] <= live.slips
    for time, _, landing in live.break_aways:
        assert t[0] <= time < landing <= t[-1]
