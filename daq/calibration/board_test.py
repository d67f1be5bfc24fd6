"""Test of a board from one short recording: its sample rate, line, clock and counting.

In the first seconds the mass is not touched: counts then are errors.  Then it is moved by hand towards +x: the count
must follow, and both channels must change their levels.
"""

from dataclasses import dataclass

import numpy as np

from daq.finalise.quality import RecordingQuality
from daq.runfile.recording import Recording
from daq.wire.quadrature import EDGES_PER_COUNT

RATE_TOLERANCE = 0.01  # deviation from the commanded rate, relative; above the 0.5 % of a ceramic resonator
PARKED_EDGES = 4  # a parked mass may dither around an edge
MOVED_EDGES = 400  # a mass that moves farther was not parked (an x4 count by itself is never far off)
HAND_EDGES = 40  # a hand moves a mass farther


@dataclass(frozen=True)
class BoardCheck:
    name: str
    ok: bool | None  # None if it could not be checked
    seen: str  # the result, with its number
    do: str = ""  # what to do if it failed


@dataclass(frozen=True)
class CountedSpan:
    """Counts in a stretch of the recording: the net count, and the span of all counts."""

    seconds: float
    counts: int
    span: int


def count_span(run: Recording, begin_s: float, end_s: float) -> CountedSpan:
    in_span = (run.time >= begin_s) & (run.time < end_s)
    if run.count is None or not in_span.any():
        return CountedSpan(0.0, 0, 0)
    count = run.count[in_span]
    return CountedSpan(float(np.ptp(run.time[in_span])), int(count[-1] - count[0]), int(np.ptp(count)))


def check_board(summary: RecordingQuality, run: Recording, parked_s: float) -> list[BoardCheck]:
    """Check a recording: the mass is not touched for ``parked_s`` seconds, then moved by hand."""
    parked = count_span(run, 0.0, parked_s)
    moved = count_span(run, parked_s, float("inf"))
    rate_deviation = summary.measured_rate_hz / summary.rate_hz - 1
    checks = [
        BoardCheck(
            "rate",
            abs(rate_deviation) <= RATE_TOLERANCE,
            f"{summary.measured_rate_hz:.6g} Hz according to the board's clock, {summary.rate_hz:.6g} requested",
            "lower --rate, or update its firmware",
        ),
        BoardCheck(
            "line",
            summary.lost + summary.crc_errors + summary.dropped_bytes == 0,
            f"{summary.lost} samples lost, {summary.crc_errors} damaged",
            "try another cable or port, a lower --rate, or a faster line",
        ),
        _check_clock(summary),
        BoardCheck(
            "counting",
            summary.illegal + summary.phase_errors == 0,
            f"{summary.illegal} illegal transitions, {summary.phase_errors} samples that contradict their logic levels",
            "check the encoder's plug and supply; move more slowly",
        ),
    ]
    if parked_s > 0:
        checks.append(_check_parked(parked, run))
    if moved.seconds > 0:
        checks.append(_check_direction(moved, run))
        levels = _check_levels(run, parked_s, moved)
        if levels is not None:
            checks.append(levels)
    return checks


def _check_clock(summary: RecordingQuality) -> BoardCheck:
    if not summary.clock_drift:
        return BoardCheck("clock", None, "the clocks could not be compared in this time")
    return BoardCheck("clock", True, summary.clock_drift)


def _check_parked(parked: CountedSpan, run: Recording) -> BoardCheck:
    edges = EDGES_PER_COUNT.get(run.rig.decoder, 1)
    result = f"{parked.counts:+d} counts in {parked.seconds:.3g} s, within a span of {parked.span}"
    if parked.span * edges > MOVED_EDGES and run.rig.decoder in ("x4", "x1"):
        return BoardCheck("parked drift", False, result + ": the mass moved", "do not touch it while it is parked")
    do = (
        "the encoder vibrates about an edge, which a J-K decoder counts; use the decoder x4"
        if "jk" in run.rig.decoder
        else "check the mount of the encoder"
    )
    return BoardCheck("parked drift", abs(parked.counts) * edges <= PARKED_EDGES, result, do)


def _check_direction(moved: CountedSpan, run: Recording) -> BoardCheck:
    edges = EDGES_PER_COUNT.get(run.rig.decoder, 1)
    pitch = run.rig.metres_per_count
    sign = -1 if pitch is not None and pitch.value < 0 else 1
    result = f"move the mass by hand towards +x: {moved.counts:+d} counts"
    if pitch is not None:
        result += f", {1e3 * moved.counts * pitch.value:+.3g} mm"
    if moved.span * edges < HAND_EDGES:
        return BoardCheck(
            "direction", False, result, "no edge was counted: check the supply of the encoder and its wires A and B"
        )
    if abs(moved.counts) * edges < HAND_EDGES:
        return BoardCheck(
            "direction", None, result + ": the mass came back", "move it in one direction and leave it there"
        )
    do = "swap the wires A and B, or change the sign of metres_per_count"
    return BoardCheck("direction", moved.counts * sign > 0, result, do)


def _check_levels(run: Recording, parked_s: float, moved: CountedSpan) -> BoardCheck | None:
    """Return whether both channels change while the mass moves; None if the board sends no levels."""
    if run.raw is None or moved.span * EDGES_PER_COUNT.get(run.rig.decoder, 1) < HAND_EDGES or not run.raw.levels.any():
        return None
    levels = run.raw.levels[run.time >= parked_s]
    constant = [name for name, bit in (("A", 1), ("B", 2)) if np.ptp(levels & bit) == 0]
    if not constant:
        return BoardCheck("channels", True, "A and B both change")
    return BoardCheck(
        "channels", False, f"{' and '.join(constant)} never changes", f"check the wire of {' and '.join(constant)}"
    )
