"""The reading thread of a recording: it owns the port, and never waits for the disk.

What it reads goes into a bounded queue; bytes that do not fit are counted and reported.  (A simulated rig outside real
time runs only as fast as it is read: for it alone, the thread waits for the queue.)  A port that is lost (pyserial
raises SerialException, or a plain OSError from ``in_waiting``) or silent is opened again, and the board is started
again.  A board that identifies itself during the stream has reset, and is started again too.

A board is silent that sends no new sample, whatever else it sends: noise, or the same samples again.  Silence is judged
by reads that brought none, not by the clock: while this process is stopped or the computer sleeps, the port collects
what comes, and the next read brings it.
"""

import queue
import threading
import time
from collections.abc import Callable

from daq.protocols.session import Session
from daq.recorder import ports
from daq.runfile import journal
from stickslip.errors import StickslipError

QUEUE_READS = 20_000  # half a minute of a 5 kHz stream
QUEUE_READS_WAITING = 8
PAUSE_S = 0.02  # between reads: what came meanwhile is read at once, and each read costs as much as 100 samples
SILENT_S = 5.0  # a board that sends no new sample for so long while sampling is lost
REOPEN_S = 30.0
REOPEN_EVERY_S = 0.25
# A step of waiting counts as so much at most: more than a read that finds nothing takes (0.1 s), or opening a port
# whose board does not answer (5 s).  Double would count a pause of the computer twice as long.
LONGEST_READ_S = 0.5
LONGEST_REOPEN_S = 6.0

Item = tuple[int, int, bytes]  # a journal record: kind, stamp in monotonic ns, bytes


class Waiting:
    """How long something has been waited for, in steps; a pause of the computer within one counts as ``longest_s``."""

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self.begin()

    def begin(self) -> None:
        self._waited, self._last = 0.0, time.monotonic()

    def step(self) -> float:
        """Return the seconds waited so far; called once a step."""
        now = time.monotonic()
        self._waited += min(now - self._last, self._longest_s)
        self._last = now
        return self._waited


class Reader(threading.Thread):
    """Starts the board, reads until enough samples came or `stop` is called, stops the board, reads the rest."""

    def __init__(
        self,
        board: Session,
        reopen: Callable[[], Session],
        rate_hz: float,
        samples: int,
        say: Callable[[str], None],
    ) -> None:
        super().__init__(name="daq reader", daemon=True)
        self.board = board
        self.waits = ports.waits_for_reader(board.url)
        self.items: queue.Queue[Item | None] = queue.Queue(QUEUE_READS_WAITING if self.waits else QUEUE_READS)
        self.tally = board.tally()
        self.heard = 0
        self.failure: BaseException | None = None
        self.ended = journal.STOPPED
        self._reopen = reopen
        self._rate_hz, self._samples = rate_hz, samples
        self._say = say
        self._stopping = threading.Event()
        self._dropped = 0

    def stop(self) -> None:
        """Ask the thread to end: it stops the board and reads the rest of the stream."""
        self._stopping.set()

    def run(self) -> None:
        """Read; None ends the queue in every case."""
        try:
            self._read_all()
        except BaseException as error:  # raised in the thread that waits for this one
            self.failure = error
        finally:
            self.board.close()
            self._put(None)

    def _read_all(self) -> None:
        began = time.monotonic()
        try:
            self.board.start()
        except OSError as error:
            if not self._recover(began, str(error)):
                return
        silence, heard = Waiting(LONGEST_READ_S), self.heard
        while not self._stopping.is_set():
            resets, reached = self.tally.resets, self.tally.reached
            try:
                data = self.board.read()
                if data:
                    self.heard += len(data)
                    self._keep(journal.RECEIVED, data)
                    self.tally.feed(data, time.monotonic())
                    if not self.waits:
                        time.sleep(PAUSE_S)
                if self.tally.resets > resets:
                    self._say("the board has restarted, so the position starts again from zero")
                    self.tally.begin_again(round((time.monotonic() - began) * self._rate_hz))
                    self.board.restart()
            except OSError as error:
                if not self._recover(began, str(error)):
                    return
                silence.begin()
            if self.tally.reached > reached:
                silence.begin()
                heard = self.heard
            elif silence.step() > SILENT_S:
                if not self._recover(began, self._explain_silence(self.heard - heard)):
                    return
                silence.begin()
                heard = self.heard
            if self.tally.reached >= self._samples:
                self.ended = journal.COMPLETE
                break
            if self.tally.notice:
                self._say(f"the board has stopped: {self.tally.notice}")
                self.ended = journal.BOARD_STOPPED
                break
        self._finish()

    def _explain_silence(self, heard: int) -> str:
        if heard:
            return f"the {heard} bytes received in {SILENT_S:g} s contain no new sample"
        return f"no data arrived for {SILENT_S:g} s"

    def _finish(self) -> None:
        try:
            self.board.stop()
            rest = self.board.drain()
        except OSError as error:
            self._keep(journal.LOST, str(error).encode())
            return
        if rest:
            self._keep(journal.RECEIVED, rest)

    def _recover(self, began: float, why: str) -> bool:
        """Try to open the port again, no longer than the run would have lasted; report and record the loss."""
        self._keep(journal.LOST, why.encode())
        self.board.close()
        left_s = (self._samples - self.tally.reached) / self._rate_hz
        limit_s = min(REOPEN_S, left_s)
        self._say(f"the port was lost ({why}). Waiting up to {limit_s:.1f} s for it; Ctrl-C stops and keeps the data")
        waiting = Waiting(LONGEST_REOPEN_S)
        while waiting.step() < limit_s and not self._stopping.wait(REOPEN_EVERY_S):
            try:
                self.board = self._reopen()
                self._keep(journal.REOPENED, self.board.url.encode())
                for stamp, data in self.board.received:
                    self._put((journal.RECEIVED, stamp, data))
                self.tally.begin_again(round((time.monotonic() - began) * self._rate_hz))
                for _, data in self.board.received:  # another board may be behind the port
                    self.tally.feed(data)
                self.board.start()
            except (OSError, StickslipError):
                self.board.close()
                continue
            self._say("the port is available again: a new segment begins")
            return True
        if not self._stopping.is_set():
            self.ended = journal.PORT_LOST
            self._say("the port did not become available again, so the run ends here")
        return False

    def _keep(self, kind: int, data: bytes) -> None:
        self._put((kind, time.monotonic_ns(), data))

    def _put(self, item: Item | None) -> None:
        if self.waits or item is None:
            self.items.put(item)
            return
        try:
            if self._dropped:
                self.items.put_nowait(
                    (journal.DROPPED, item[1], self._dropped.to_bytes(journal.DROPPED_BYTES, "little"))
                )
                self._dropped = 0
            self.items.put_nowait(item)
        except queue.Full:
            self._dropped += len(item[2])
