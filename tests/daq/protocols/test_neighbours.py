"""Lines without a checksum: sound ones are kept whatever their times, damaged ones are found by their neighbours."""

import numpy as np
import pytest

from daq.protocols import text
from daq.protocols.session import decode_whole

COUNTS_PER_S = 0.22 / 7.67e-6  # of the belt


def stick_slip(t):
    """Return counts of a stick at the belt's speed and a half swing back, and again: up to 100 counts a ms."""
    swing, reach = np.pi / 5.93, 0.13 / 7.67e-6
    stick = 2 * reach / COUNTS_PER_S
    phase = (t + 0.3) % (stick + swing)
    return np.where(phase < stick, COUNTS_PER_S * phase - reach, reach * np.cos(5.93 * (phase - stick)))


MOTIONS = {"stick-slip": stick_slip, "at rest": lambda t: 77 + 0 * t, "slow": lambda t: 300 + 40 * np.sin(0.7 * t)}


def sometimes(share, late):
    return lambda rng, n: np.where(rng.random(n) < share, late(rng, n) if callable(late) else late, 0)


def polling(rng, n):
    return rng.integers(0, 5, n) * 4 + sometimes(0.02, lambda rng, n: rng.integers(25, 225, n) * 4)(rng, n)


# Period, and how late each line is, us; unit of the printed time.
TIMERS = {
    "5000 us, 5 % late by 4": (5000, sometimes(0.05, 4), "us"),
    "1000 us, 5 % late by 8": (1000, sometimes(0.05, 8), "us"),
    "interrupt, 3 % late": (2000, sometimes(0.03, lambda rng, n: rng.integers(1, 16, n) * 4), "us"),
    "polling at 1 kHz": (1000, polling, "us"),
    "millis at 5 ms, 10 % late by 1": (5000, sometimes(0.1, 1000), "ms"),
    "millis at 1 ms, 10 % late by 1": (1000, sometimes(0.1, 1000), "ms"),
    "millis as us, 5 % late by a fraction": (
        5000,
        sometimes(0.05, lambda rng, n: rng.integers(0, 1500, n)),
        "ms as us",
    ),
    "jitter": (2000, lambda rng, n: np.round(30 * rng.normal(size=n)).astype(int) + 200, "us"),
}


def printed(name, motion, seed, n, *, count_is_late):
    """Return n lines, with their times as printed (us) and their counts."""
    period, late, unit = TIMERS[name]
    base = 12_000 + period * np.arange(n)
    true = base + late(np.random.default_rng(seed), n)
    count = np.floor(MOTIONS[motion]((true if count_is_late else base) * 1e-6)).astype(int)
    shown = true if unit == "us" else true // 1000 * 1000
    numbers = shown // 1000 if unit == "ms" else shown
    return [b"%d,%d\n" % row for row in zip(numbers.tolist(), count.tolist(), strict=True)], shown, count


def decoded(lines, name):
    """Return the stream, and the number of the line that each sample came from: a line is a read."""
    period, _, unit = TIMERS[name]
    header = {"columns": "ms,count" if unit == "ms" else "t_us,count", "rate_hz": 1e6 / period}
    stream = decode_whole(text, list(enumerate(lines)), header)
    return stream, stream.stamp_ns


def counts(stream):
    return (stream.up.astype(np.int64) - stream.down.astype(np.int64) + 2**31) % 2**32 - 2**31


@pytest.mark.parametrize(
    ("motion", "count_is_late"), [("stick-slip", True), ("stick-slip", False), ("at rest", False), ("slow", True)]
)
@pytest.mark.parametrize("name", TIMERS)
def test_no_sound_count_is_lost_for_its_time(name, motion, count_is_late):
    n = 2700
    lines, shown, count = printed(name, motion, 5, n, count_is_late=count_is_late)
    stream, line = decoded(lines, name)
    assert stream.crc_errors == 0
    assert np.array_equal(line, np.arange(1, n))
    assert np.array_equal(counts(stream), count[1:])
    assert np.array_equal(np.diff(stream.seq) & 0xFFFF, np.ones(n - 2))  # none repeated, none missing
    assert np.all(np.diff(stream.ticks) > 0)
    assert np.array_equal((stream.ticks + stream.time_error) & 0xFFFFFFFF, shown[1:])
    if count_is_late and "us" in name and motion == "stick-slip":
        # A line that was truly late keeps its time where the count shows it: the position would be wrong otherwise.
        moved = np.abs(stick_slip(shown[1:] * 1e-6) - stick_slip(stream.ticks * 1e-6))
        assert moved.max() < 4


@pytest.mark.parametrize("name", ["5000 us, 5 % late by 4", "interrupt, 3 % late", "millis at 5 ms, 10 % late by 1"])
def test_damaged_lines_are_still_found_among_late_ones(name, damaged):
    passed = total = 0
    for motion in MOTIONS:
        lines, shown, count = printed(name, motion, 8, 8000, count_is_late=True)
        lines, changed = damaged(lines, 9)
        stream, line = decoded(lines, name)
        untrue = (counts(stream) != count[line]) | (np.abs(stream.ticks - shown[line]) > 3) & (stream.time_error == 0)
        touched = np.isin(line, list(changed))
        passed, total = passed + np.count_nonzero(untrue & touched), total + len(changed)
        # Those that no damaged line is near are all there.
        near = np.add.outer(sorted(changed), np.arange(-2, 3))
        assert np.isin(np.setdiff1d(np.arange(8, 7999), near), line[counts(stream) == count[line]]).all()
    assert passed <= 0.03 * total


def one_line_changed(change):
    sent = [(2000 * k + 7, int(np.floor(20_000 * np.sin(0.005 * k)))) for k in range(200)]
    time, count = change(*sent[90])
    lines = [b"%d,%d\n" % (row if k != 90 else (time, count)) for k, row in enumerate(sent)]
    return decode_whole(text, [(0, b"".join(lines))], {"columns": "t_us,count", "rate_hz": 500.0}), sent


@pytest.mark.parametrize("off", [40, 900, -700, 4000, 80_000, 1 << 31])
def test_a_line_with_a_wrong_time_keeps_its_count(off):
    stream, sent = one_line_changed(lambda time, count: (time + off, count))
    assert stream.crc_errors == 0
    assert np.array_equal(np.column_stack((stream.ticks, counts(stream))), sent[1:])
    assert np.flatnonzero(stream.time_error).tolist() == [89]
    assert abs(stream.time_error[89]) == off % (1 << 31) or off == 1 << 31 or stream.time_error[89] == off


def test_a_line_that_comes_twice_is_no_late_one():
    lines = [b"%d,%d\n" % (k, 30 * k) for k in range(200)]
    lines.insert(100, lines[100])
    stream = decode_whole(text, [(0, b"".join(lines))], {"columns": "ms,count", "rate_hz": 1000.0})
    assert np.count_nonzero(np.diff(stream.ticks) == 0) == 1  # left out by `counters.FrameOrder`
    assert not stream.time_error.any()


@pytest.mark.parametrize("noise", [0.0, 5.0, 30.0, 100.0])
def test_jitter_kicks_jumps_and_gaps_are_no_damage(noise):
    rng = np.random.default_rng(int(noise))
    k = np.arange(20_000)
    time = 2000 * k + np.round(noise * rng.normal(size=k.size)).astype(int)
    speed = np.where(k // 700 % 2, 40.0, -3.0) + np.where(k // 333 % 3 == 0, 5.0, 0.0)  # kicked, and reversed
    count = np.floor(np.cumsum(speed)).astype(int) + 500 * (k > 9000)  # and a cog that slipped
    sent = (k % 997 != 5) & (k // 40 != 77)
    data = b"".join(b"%d,%d\n" % row for row in zip(time[sent].tolist(), count[sent].tolist(), strict=True))
    stream = decode_whole(text, [(0, data)], {"columns": "t_us,count", "rate_hz": 500.0})
    assert stream.crc_errors <= 1e-4 * k.size * (noise > 0)
