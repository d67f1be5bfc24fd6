"""The quality of a recording: the numbers in ``daq record``'s answer, and the warnings that follow from them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.runfile import journal
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.stream.integrity import CheckedCounts
from daq.stream.timeline import Piece
from daq.wire import counters, frames
from daq.wire.quadrature import EDGES_PER_COUNT

# What `RecordingQuality` has of `DataTotals`.
COUNTED = ("samples", "lost", "crc_errors", "illegal", "phase_errors", "both_moved", "retimed", "travel")
NOT_IN_JSON = ("travel", "unit", "port_lost")
LEAST_HELD = 0.9  # share of the requested samples: with fewer, or more than the rest lost, a run is incomplete
# A drift of fewer standard errors than CLEAR is not significant.  Its bound is then reported, unless that is more than
# TELLING_PPM: crystals keep 100 ppm, ceramic resonators 5000.
CLEAR, TELLING_PPM = 2.0, 1000.0
REASONS = {"clock": "the clock jumped"}  # texts for the reasons of a segment that are not their own text
LONG_GAP_S = 0.5  # length from which a warning gives the time of a gap


@dataclass(frozen=True, repr=False)
class RecordingQuality:
    """The findings of one recording, by `daq.record`, ``daq record`` or ``daq recover``.

    Attributes
    ----------
    samples, lost : int
        Samples in the file; samples missing between them (gaps of a lost port are not counted, they are timed).
    crc_errors, illegal, phase_errors : int
        Damaged frames; illegal double transitions the board counted; samples whose count disagrees with its levels.
    segments : int
        1 for an uninterrupted run.
    rate_hz, measured_rate_hz : float
        Commanded, and by the device's clock.
    clock_ppm, clock_ppm_error : float or None
        Drift of the device's clock against the host's, positive when fast, and how far off it may be; None where it
        cannot be known.
    duration_s : float
        From the first sample to one period after the last.
    peak_edge_rate_hz : float
        Fastest edge rate between two neighbouring samples.
    both_moved, dropped_bytes : int
        Samples in which both counters moved; bytes the recorder could not keep.
    travel : tuple of float
        Least and largest position.
    unit : str
        "m", or "count" for a rig that was not calibrated.
    port_lost : int
        How often the port was lost.  The time without it does not count as lost samples; a warning gives its length.
    asked_s : float or None
        Requested duration; None if there was none.
    ended : str
        "complete", "stopped" (Ctrl-C), "port lost", "board stopped", or the name of the signal that ended it; empty for
        a recorder that was killed.
    retimed : int
        Samples whose time as sent was not true and has been interpolated.
    file : Path or None
        The run file.
    warnings : tuple of str
        What a careful user should know about the data.
    """

    samples: int
    lost: int
    crc_errors: int
    illegal: int
    phase_errors: int
    segments: int
    rate_hz: float
    measured_rate_hz: float
    clock_ppm: float | None
    clock_ppm_error: float | None
    duration_s: float
    peak_edge_rate_hz: float
    both_moved: int
    dropped_bytes: int
    travel: tuple[float, float]
    unit: str
    port_lost: int = 0
    asked_s: float | None = None
    ended: str = ""
    retimed: int = 0
    file: Path | None = None
    warnings: tuple[str, ...] = ()

    @property
    def clock_drift(self) -> str:
        """What is known of the board's clock against this machine's, in words; "" where that says nothing."""
        if self.clock_ppm is None:
            return ""
        drift, error = self.clock_ppm, self.clock_ppm_error
        if error is None:
            return f"the board's clock deviates by {drift:+.0f} ppm"
        if abs(drift) >= CLEAR * error:
            return f"the board's clock deviates by {drift:+.0f} ppm (+- {error:.0f})"
        most = abs(drift) + CLEAR * error
        return f"the board's clock agrees with this computer's to within {most:.0f} ppm" if most < TELLING_PPM else ""

    @property
    def short(self) -> bool:
        """Whether too little of the requested duration was recorded, unless it was stopped with Ctrl-C."""
        if self.asked_s is None or self.ended in (journal.STOPPED, ""):
            return False
        return self.samples < LEAST_HELD * self.asked_s * self.rate_hz

    @property
    def sparse(self) -> bool:
        """Whether too many samples are lost between the first and the last."""
        return self.lost > (1 - LEAST_HELD) * (self.samples + self.lost)

    def __repr__(self) -> str:
        lost = f"{self.lost} samples lost" if self.lost else "no sample lost"
        warnings = "".join(f"\n warning: {text}" for text in self.warnings)
        name = "" if self.file is None else f" {self.file.name}"
        head = f"{self.samples} samples, {self.duration_s:.4g} s at {self.rate_hz:g} Hz, {lost}"
        return f"<RecordingQuality{name}: {head}{warnings}>"

    def as_json(self) -> dict[str, Any]:
        """Return the JSON document of ``daq record`` and ``daq recover``."""
        document = {name: value for name, value in vars(self).items() if name not in NOT_IN_JSON}
        return document | {"warnings": list(self.warnings)}


@dataclass
class DataTotals:
    """Totals over the samples of a run, added piece by piece; fields without a comment are as of `RecordingQuality`."""

    samples: int = 0
    lost: int = 0
    gaps: int = 0  # places where samples are missing
    longest_gap: int = 0  # samples missing in the longest gap, and when it begins
    longest_after_s: float = 0.0
    illegal: int = 0
    phase_errors: int = 0
    both_moved: int = 0
    retimed: int = 0
    overruns: int = 0  # samples that the board took late
    reasons: list[str] = field(default_factory=list)  # what began each segment
    jumped_s: list[float] = field(default_factory=list)  # times at which sequence numbers jumped
    leapt: list[tuple[float, float]] = field(default_factory=list)  # when the board's clock jumped, and by how much, s
    # when the board paused without a gap in its sequence, and for how long, s
    paused: list[tuple[float, float]] = field(default_factory=list)
    # segments with a new identification, and its number
    segment: list[int] = field(default_factory=list)
    source: list[int] = field(default_factory=list)
    travel: tuple[float, float] = (np.inf, -np.inf)
    # sample periods from the start of the run to the first and to the last sample
    places: tuple[int, int] | None = None
    first_ns: int = 0  # host's stamp of the first sample
    last_s: float = 0.0  # time of the last sample
    crc_errors: int = 0
    unknown: int = 0  # frames of an unknown kind or length
    notices: list[str] = field(default_factory=list)  # what the board reported
    repeated: int = 0  # samples left out because their time did not advance
    peak_count_rate: float = 0.0  # `CheckedCounts`

    def take(self, piece: Piece, checked: CheckedCounts, position: NDArray[np.float64]) -> None:
        """Add the next samples, and their positions."""
        samples, lost = piece.samples, checked.lost
        self.crc_errors += len(piece.frames.crc_frame)
        self.unknown += piece.frames.unknown
        self.peak_count_rate = max(self.peak_count_rate, checked.peak_count_rate)
        self.notices += [text for _, text in piece.frames.notices]
        if not len(samples):
            return
        if not self.samples:
            self.first_ns = int(samples.stamp_ns[0])
        longest = int(np.argmax(lost))
        if lost[longest] > self.longest_gap:
            self.longest_gap = int(lost[longest])
            self.longest_after_s = float(samples.time[longest - 1]) if longest else self.last_s
        self.lost += int(lost.sum())
        self.gaps += int(np.count_nonzero(lost))
        self.illegal += checked.illegal
        self.phase_errors += int(np.count_nonzero(checked.flags & counters.FLAG_PHASE))
        self.both_moved += int(np.count_nonzero(checked.flags & counters.FLAG_BOTH))
        self.retimed += int(np.count_nonzero(checked.flags & counters.FLAG_TIME))
        self.overruns += int(np.count_nonzero(samples.status & frames.OVERRUN))
        start_s = samples.time[checked.starts - self.samples].tolist()
        self.jumped_s += [time_s for time_s, reason in zip(start_s, checked.reasons, strict=True) if reason == "jumped"]
        leaps = zip(start_s, checked.leap_s.tolist(), checked.reasons, strict=True)
        self.leapt += [(time_s, leap_s) for time_s, leap_s, reason in leaps if reason == "clock"]
        pauses = samples.time[checked.paused - self.samples].tolist()
        self.paused += list(zip(pauses, checked.paused_s.tolist(), strict=True))
        for number, source in enumerate(checked.source.tolist(), start=len(self.reasons)):
            if not self.source or source != self.source[-1]:
                self.segment.append(number)
                self.source.append(source)
        self.reasons += checked.reasons
        self.travel = min(self.travel[0], float(position.min())), max(self.travel[1], float(position.max()))
        self.places = (int(samples.place[0]) if self.places is None else self.places[0]), int(samples.place[-1])
        self.last_s = float(samples.time[-1])
        self.samples += len(samples)


def assess_run(recorded: journal.Journal, totals: DataTotals, run: Recording) -> RecordingQuality:
    """Return the findings of a run, without the warnings about the data (`find_warnings`)."""
    first, last = totals.places or (0, 0)
    return RecordingQuality(
        **{name: getattr(totals, name) for name in COUNTED},
        segments=len(totals.reasons),
        rate_hz=run.rate_hz,
        measured_rate_hz=(last - first) / totals.last_s if totals.last_s > 0 else run.rate_hz,
        clock_ppm=run.clock_ppm,
        clock_ppm_error=run.clock_ppm_error,
        duration_s=totals.last_s + 1 / run.rate_hz,
        peak_edge_rate_hz=totals.peak_count_rate * EDGES_PER_COUNT.get(run.rig.decoder, 1),
        dropped_bytes=sum(
            int.from_bytes(record.data, "little")
            for record in recorded.records.of_kind(journal.DROPPED)
            if len(record.data) == journal.DROPPED_BYTES
        ),
        unit=run.unit,
        port_lost=recorded.records.kinds.count(journal.LOST),
        asked_s=recorded.header["samples"] / run.rate_hz if recorded.header.get("samples") is not None else None,
        ended=next(map(journal.end_reason, recorded.records.of_kind(journal.END)), ""),
    )


def find_warnings(
    quality: RecordingQuality,
    recorded: journal.Journal,
    totals: DataTotals,
    rig: Rig,
) -> list[str]:
    """Return one sentence for each fault of the data, with its number."""
    sentences = [*_find_outages(recorded.records), *_find_data_warnings(quality, totals, rig)]
    sentences += _explain_shortfall(quality, totals)
    if recorded.lost_tail:
        sentences.append(f"the last {recorded.lost_tail} bytes of the journal are an incomplete record")
    if recorded.damaged:
        note = f"the journal is kept: {recorded.path.name}"
        sentences.append(f"{recorded.damaged} bytes of the journal are damaged; {note}")
    return sentences


def _explain_shortfall(quality: RecordingQuality, totals: DataTotals) -> list[str]:
    """Return sentences for a run that is shorter than requested, and for its longest gap."""
    sentences = []
    if quality.short and quality.asked_s is not None:
        causes = {
            journal.COMPLETE: "samples are missing",
            journal.PORT_LOST: "the port was lost",
            journal.BOARD_STOPPED: "the board stopped",
            journal.SOURCE_FAILED: "the source failed",
            journal.SOURCE_ENDED: "the source ended",
            journal.SOURCE_SILENT: "the source gave no further samples",
        }
        samples_s = quality.samples / quality.rate_hz
        cause = causes.get(quality.ended, f"stopped by {quality.ended}")
        sentences.append(
            f"{samples_s:.3g} s of samples of the requested {quality.asked_s:.3g} s were recorded: {cause}"
        )
    if quality.sparse:
        sentences.append(f"{quality.lost / (quality.samples + quality.lost):.0%} of the samples are lost")
    gap_s = totals.longest_gap / quality.rate_hz
    if gap_s > LONG_GAP_S:
        sentences.append(
            f"the longest gap begins {totals.longest_after_s:.3f} s after the first sample and lasts {gap_s:.3g} s"
        )
    return sentences


def _find_outages(records: journal.Records) -> list[str]:
    """Return one sentence for all times the port was lost and reopened, and one if it was not reopened at last."""
    first = last_read = None
    lost = ""
    outages: list[tuple[int, int, str]] = []  # how long, since when, and why
    final = []
    # Of the reads, which are nearly the whole journal, the first one and the last ones before something else.
    first_read, next_kinds = records.kinds.find(journal.RECEIVED), records.kinds[1:] + bytes([journal.END])
    pairs = enumerate(zip(records.kinds, next_kinds, strict=True))
    for record in records.at(
        number for number, (kind, then) in pairs if number == first_read or {kind, then} != {journal.RECEIVED}
    ):
        if record.kind == journal.RECEIVED:
            if first is None:
                first = record.stamp_ns
            last_read = record.stamp_ns
        elif record.kind == journal.LOST:
            lost = record.data.decode(errors="replace")
        elif last_read is None or first is None:
            continue
        elif record.kind == journal.REOPENED:
            outages.append((record.stamp_ns - last_read, last_read - first, lost))
            lost = ""
        elif record.kind == journal.END and b"port lost" in record.data:
            final.append(
                f"the port was lost ({lost}) {(last_read - first) / 1e9:.3g} s after the start and did not "
                "become available again"
            )
        elif record.kind == journal.END and journal.end_reason(record) == journal.SOURCE_FAILED:
            final.append(f"the source failed: {lost}")
    return [*_describe_outages(outages), *final]


def _describe_outages(outages: Sequence[tuple[int, int, str]]) -> list[str]:
    """Return one sentence for all outages: how long each was, ns, when it began after the start, ns, and why."""
    if not outages:
        return []
    longest_ns, start_ns, reason = max(outages, key=itemgetter(0))
    if len(outages) == 1:
        return [f"the port was lost ({reason}) and reopened: {longest_ns / 1e6:.0f} ms are missing"]
    total_s = sum(outage_ns for outage_ns, _, _ in outages) / 1e9
    longest = f"the longest outage {longest_ns / 1e6:.0f} ms, {start_ns / 1e9:.3g} s after the start ({reason})"
    return [f"the port was lost and reopened {len(outages)} times: {total_s:.3g} s are missing in all, {longest}"]


def _list_first(texts: Sequence[str]) -> str:
    """Return the first five texts, and how many more there are."""
    return ", ".join(texts[:5]) + (f" and {len(texts) - 5} more times" if len(texts) > 5 else "")


def _find_data_warnings(quality: RecordingQuality, totals: DataTotals, rig: Rig) -> list[str]:
    """Return one sentence for each kind of damage in the data, with its number."""
    edges = EDGES_PER_COUNT.get(rig.decoder, 1)
    reasons = "; ".join(sorted({REASONS.get(why, why) for why in totals.reasons[1:]}))
    jumps = _list_first([f"{time_s:.3f} s" for time_s in totals.jumped_s])
    leaps = _list_first([f"by {leap_s:.3g} s at {time_s:.3f} s" for time_s, leap_s in totals.leapt])
    pauses = _list_first([f"for {pause_s:.3g} s at {time_s:.3f} s" for time_s, pause_s in totals.paused])
    sentences = [
        (quality.lost, f"{quality.lost} samples were lost in {totals.gaps} places"),
        (quality.crc_errors, f"{quality.crc_errors} damaged frames were discarded"),
        (totals.unknown, f"{totals.unknown} frames had an unknown kind or length"),
        (
            quality.illegal,
            f"{quality.illegal} illegal transitions: the encoder was too fast for its decoder; the count may be off by "
            f"{2 * quality.illegal}",
        ),
        (quality.phase_errors, f"{quality.phase_errors} samples contradict their logic levels"),
        (totals.overruns, f"the board took {totals.overruns} samples late"),
        (totals.repeated, f"{totals.repeated} samples were repeated or late and were omitted"),
        (
            quality.retimed,
            f"{quality.retimed} samples had times that did not fit their neighbours; these times were interpolated",
        ),
        (quality.dropped_bytes, f"{quality.dropped_bytes} bytes were lost because this computer was too slow"),
        (
            quality.segments - 1,
            f"{quality.segments} segments: {reasons}; positions are not connected across them",
        ),
        (
            len(totals.jumped_s),
            f"the board's sequence numbers jumped against its clock, {jumps} after the first sample. The "
            "board was reset or sent wrong numbers. A new segment begins each time",
        ),
        (
            len(totals.leapt),
            f"the board's clock jumped, {leaps}, relative to its sequence numbers and this computer's clock. "
            "A new segment begins each time, with times from the sequence numbers",
        ),
        (
            len(totals.paused),
            f"the board paused, {pauses}, without a gap in its sequence numbers",
        ),
    ]
    sentences += [(1, f"the board stopped: {text}") for text in totals.notices]
    half = 2 ** (rig.counter_bits - 1)
    steps = round(quality.peak_edge_rate_hz / edges / quality.rate_hz)
    sentences.append(
        (
            steps > half,
            f"the counters moved by {steps} of {2 * half} within one sample. They may have rolled over "
            "unnoticed, which makes positions wrong. Record at a higher --rate",
        )
    )
    if rig.decoder in ("jk", "jk-latched"):
        sentences.append(
            (
                1,
                f"a {rig.decoder} counter adds a line ({edges} edges) each time the encoder vibrates across an edge, "
                "so expect drift",
            )
        )
        sentences.append((quality.both_moved, f"both counters moved within one sample, {quality.both_moved} times"))
    return [text for count, text in sentences if count]
