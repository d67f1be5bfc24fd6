"""Samples of a board as they are placed on a time axis, before their counts are checked."""

import numpy as np

from daq.runfile.rig import Rig
from daq.stream.integrity import CountCheck, CountSurvey
from daq.stream.timeline import Samples


def make_samples(index, begun_by=("reopened",), **columns):
    """Return samples at 1 kHz, in frames of eight, of a board that is still."""
    index, n = np.asarray(index), len(index)
    zeros = np.zeros(n, np.uint16)
    made = {"time": index / 1000, "part": np.zeros(n, np.int64), "index": index, "ticks": index * 1000}
    made |= {"frame": np.arange(n) // 8, "stamp_ns": index * 1_000_000, "source": np.zeros(n, np.int64)}
    made |= {"up": zeros, "down": zeros, "status": zeros.astype(np.uint8), "illegal": zeros, "place": np.arange(n)}
    return Samples(begun_by=begun_by, **(made | {"belt": None, "edge": None} | columns))


def check_counts(samples, ident=None, rate_hz=1000.0):
    survey = CountSurvey([ident], Rig().counter_bits, rate_hz, starts_at_phase=True)
    survey.take(samples)
    return CountCheck(survey, Rig()).take(samples)
