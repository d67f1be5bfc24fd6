"""Follow a journal that is being written: the samples since the last look, decoded as by the finaliser.

A chunk of bytes is decoded together with the last lines before it, so that its first samples have neighbours.  Only the
samples of a chunk after the last known one are passed on; counts and times continue from there.
"""

import os
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from daq import protocols
from daq.finalise.blocks import BlockStream
from daq.finalise.run import read_calibration
from daq.protocols import blocks
from daq.protocols.session import decode_whole
from daq.runfile import journal, journal_header, journal_records
from daq.runfile.belt_counter import BeltCount
from daq.runfile.journal import Record
from daq.runfile.rig import Rig
from daq.runfile.run_data import positions
from daq.stream import connections, timeline
from daq.stream.integrity import CheckedCounts, CountCheck, CountSurvey
from daq.wire import counters, decode, frames
from stickslip.compute.arrays import Array, rows
from stickslip.errors import InputError

# Lines decoded again with the next chunk: a text line needs neighbours on both sides for its time to be judged.
OVERLAP_LINES = 6
MOST_OVERLAP = 1 << 14  # bytes that are kept of a stream without lines, such as noise at a wrong baud rate
MOST_BYTES = 1 << 18  # part of a journal read at once, 0.2 s of CPU time: a viewer that starts late catches up in steps


@dataclass(frozen=True)
class NewSamples:
    """Samples since the last look, k of them, in order."""

    time: Array  # (k,) s since the first sample of the recording, and m (counts without a calibration)
    position: Array
    # (k,) true for the first sample of a segment, which is not connected with the previous one
    fresh: np.typing.NDArray[np.bool_]
    # (k,) m, of the belt's encoder, each segment from its own reading; None without one
    belt: Array | None = None
    stamp_ns: np.typing.NDArray[np.int64] | None = None  # (k,) host's monotonic clock at reception; None in a run file


@dataclass
class JournalTotals:
    """The totals so far; ``crc_errors`` are damaged frames or lines."""

    samples: int = 0
    lost: int = 0
    crc_errors: int = 0
    illegal: int = 0
    phase_errors: int = 0
    segments: int = 0


@dataclass(frozen=True)
class _LastSample:
    ticks: int
    time: float
    count: int
    index: int
    belt: int = 0


class JournalTail:
    """The samples of a journal, as they arrive.

    path: The journal; it is only read.
    header: How the recording was started.
    rig: Its calibration, once the board has sent it.
    counts: Totals so far.
    ended: How the recording ended, "" until then (`daq.runfile.journal`).
    port_lost: Why the port was lost, "" while it is connected.
    Raises InputError if the file is missing, or not a journal.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        header = journal.read_header(path)
        self.header: dict[str, Any] = journal_header.complete(header, path)
        self.rig = Rig()
        self.counts = JournalTotals()
        self.ended = self.port_lost = ""
        self._of_blocks = self.header["protocol"] == blocks.NAME
        self.block_stream = BlockStream(self.header)
        self._backend = protocols.load("frames" if self._of_blocks else self.header["protocol"], str(path))
        self._rate_hz = float(self.header["rate_hz"])
        self.bytes_read = len(journal.MAGIC)
        self._reads: list[tuple[int, bytes]] = []
        self._configuration: list[Record] = []
        self._ident: frames.Ident | None = None
        self._last: _LastSample | None = None
        self._first_stamp: int | None = None
        self._trailing_damage = 0
        self._calibrated = self._complete = False

    @property
    def unit(self) -> str:
        """Of positions: "m", or "count" without a calibration."""
        return "count" if self.rig.metres_per_count is None and self.header["columns"] != blocks.POSITIONS else "m"

    def fork(self) -> "JournalTail":
        """Return another tail that continues at the position of this one."""
        copied = copy(self)
        copied.counts, copied.block_stream = replace(self.counts), copy(self.block_stream)
        return copied

    def poll(self, most_bytes: int = MOST_BYTES) -> list[NewSamples]:
        """Return the samples since the last call, in order, from at most so many bytes; an empty list without any.

        Raises FileNotFoundError if the journal is gone: its run file is in place, or its folder was removed; InputError
        if another journal has its name.
        """
        with self.path.open("rb") as file:
            if file.seek(0, os.SEEK_END) < self.bytes_read:
                what = "is shorter than before, so it belongs to another recording"
                raise InputError(what, str(self.path), "open the view of that recording")
            file.seek(self.bytes_read)
            content = journal.Content(journal.MAGIC + file.read(most_bytes))
        samples: list[NewSamples] = []
        reads: list[tuple[int, bytes]] = []
        end = len(journal.MAGIC)
        for located in journal_records.scan(content):
            record = located.record
            end = located.at + record.size
            if record.kind == journal.RECEIVED:
                reads.append((record.stamp_ns, record.data))
            elif record.kind == journal.LOST:
                self.port_lost = record.data.decode(errors="replace") or "without a reason"
            elif record.kind == journal.REOPENED:
                samples += self._decode(reads)
                reads, self._reads, self._last, self._trailing_damage = [], [], None, 0
                self.port_lost = ""
            elif record.kind == journal.CONFIGURATION:
                self._configuration.append(record)
            elif record.kind == journal.END:
                self.ended = journal.end_reason(record)
        self.bytes_read += end - len(journal.MAGIC)
        return samples + self._decode(reads)

    def _decode(self, reads: list[tuple[int, bytes]]) -> list[NewSamples]:
        if not reads:
            return []
        if self._of_blocks:
            return self._unpack_blocks(reads)
        self._reads = [*self._reads, *reads]  # a fork may have the other one
        stream = decode_whole(self._backend, self._reads, self.header)
        self._ident = connections.replace_implausible(stream).ident or self._ident
        self._calibrate(stream)
        self._reads = _keep_last_lines(self._reads, self._backend.DELIMITER)
        if not len(stream.n) or self._complete:
            return []
        tick_ns = self._ident.tick_ns if self._ident else 1000
        (samples, _), *_ = timeline.Timeline([[stream]], self._rate_hz, tick_ns)
        samples = replace(samples, source=np.zeros(len(samples), np.int64))
        n_known = self._find_last(samples) + 1
        if self.header["samples"] is not None and len(samples) > n_known:
            # As in the finaliser: samples after the requested ones are dropped.
            requested = (
                samples.time + self._find_offset(samples, n_known) < (self.header["samples"] - 0.5) / self._rate_hz
            )
            self._complete = not requested.all()
            samples = rows(samples, requested)
        known, new = (rows(samples, part) for part in (slice(n_known), slice(n_known, None)))
        starts_at_phase = self.header["protocol"] == "frames"
        survey = CountSurvey([self._ident], self.rig.counter_bits, self._rate_hz, starts_at_phase=starts_at_phase)
        survey.take(samples)
        # The finaliser also begins a segment after a gap in which the counters may have rolled over, which depends on
        # the fastest motion of the whole run.
        check = CountCheck(survey, self.rig, safe_gap_s=np.inf)
        checked_before, checked = check.take(known), check.take(new)
        self._count(stream, samples, checked, n_known)
        if not len(new):
            return []
        fresh = np.zeros(len(new), np.bool_)
        fresh[checked.starts - n_known] = True
        count, time = checked.count.copy(), new.time + self._find_offset(samples, n_known)
        belt = np.zeros(len(samples), np.int64)
        if samples.belt is not None:
            begins = np.concatenate((np.diff(known.part, prepend=-1) != 0, fresh))
            belt = BeltCount().take(samples.belt, begins, np.full(len(samples), self.rig.counter_bits))
        if n_known and self._last is not None:
            same = np.cumsum(fresh) == 0
            count[same] += self._last.count - checked_before.count[-1]
            belt[n_known:][same] += self._last.belt - belt[n_known - 1]
        ticks, index = (int(column[-1]) for column in (new.ticks, new.index))
        self._last = _LastSample(ticks, float(time[-1]), int(count[-1]), index, int(belt[-1]))
        pitch = self.rig.belt_metres_per_count
        belt_position = (
            None if samples.belt is None or pitch is None else pitch.value * belt[n_known:].astype(np.float64)
        )
        return [NewSamples(time, positions(count, self.rig), fresh, belt_position, new.stamp_ns)]

    def _unpack_blocks(self, reads: list[tuple[int, bytes]]) -> list[NewSamples]:
        if self._configuration and not self._calibrated:
            _, self.rig, _ = read_calibration(self._configuration, [], None)
            self._calibrated = True
        pieces = []
        for stamp_ns, data in reads:
            (samples, sent), checked, values = self.block_stream.take(stamp_ns, data)
            self.counts.crc_errors += len(sent.crc_frame)
            self.counts.lost += int(checked.lost.sum())
            self.counts.samples += len(samples)
            self.counts.segments += len(checked.starts)
            if len(samples):
                position = positions(values.astype(np.int64), self.rig) if values.dtype.kind == "i" else values
                fresh = np.zeros(len(samples), np.bool_)
                fresh[checked.starts] = True
                pieces.append(NewSamples(samples.time, position.astype(np.float64), fresh, None, samples.stamp_ns))
        return pieces

    def _find_offset(self, samples: timeline.Samples, n_known: int) -> float:
        """Return what the times of samples lack to those of the recording, s."""
        if n_known and self._last is not None:
            return self._last.time - float(samples.time[n_known - 1])
        if self._first_stamp is None:
            self._first_stamp = int(samples.stamp_ns[n_known])
        return (int(samples.stamp_ns[n_known]) - self._first_stamp) / 1e9

    def _find_last(self, samples: timeline.Samples) -> int:
        """Return the index of the last known sample by its device time, -1 if it is not there."""
        if self._last is None:
            return -1
        after = (samples.ticks - self._last.ticks + (1 << 31) & 0xFFFFFFFF) - (1 << 31)
        matches = np.flatnonzero(after == 0)
        if not matches.size:  # another time was interpolated for it
            matches = np.flatnonzero((after < 0) & (samples.part == 0))
        return int(matches[-1]) if matches.size else -1

    def _count(self, stream: decode.Stream, samples: timeline.Samples, checked: CheckedCounts, n_known: int) -> None:
        """Add to the totals what was checked after so many known samples."""
        damaged = int(np.count_nonzero(stream.crc_frame > (samples.frame[n_known - 1] if n_known else -1)))
        self.counts.crc_errors += max(0, damaged - self._trailing_damage)
        self._trailing_damage = int(np.count_nonzero(stream.crc_frame >= len(stream.n)))
        lost = int(checked.lost.sum())
        if not n_known and self._last is not None:
            lost += (int(samples.index[0]) - self._last.index & 0xFFFF) - 1 - int(checked.lost[0])
        self.counts.samples += len(checked.count)
        self.counts.segments += len(checked.starts)
        self.counts.lost += lost
        self.counts.illegal += checked.illegal
        self.counts.phase_errors += int(np.count_nonzero(checked.flags & counters.FLAG_PHASE))

    def _calibrate(self, stream: decode.Stream) -> None:
        """Read the calibration once: the one given at the start, otherwise the board's."""
        if not self._calibrated and (self._configuration or stream.configs):
            _, self.rig, _ = read_calibration(self._configuration, [text for _, text in stream.configs], self._ident)
            self._calibrated = True
        elif not self._calibrated and self._ident is not None:
            self.rig = replace(self.rig, decoder=self._ident.decoder, counter_bits=self._ident.counter_bits)


def _keep_last_lines(reads: list[tuple[int, bytes]], delimiter: bytes) -> list[tuple[int, bytes]]:
    """Return the reads from the last complete lines on, to be decoded again with the next chunk."""
    content = b"".join(data for _, data in reads)
    begin_of_line = len(content)
    for _ in range(OVERLAP_LINES + 1):
        begin_of_line = content.rfind(delimiter, 0, begin_of_line)
        if begin_of_line < 0:
            break
    begin = begin_of_line + len(delimiter) if begin_of_line >= 0 else max(0, len(content) - MOST_OVERLAP)
    return reads if begin == 0 else [(reads[-1][0], content[begin:])]
