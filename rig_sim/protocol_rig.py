"""``rig://SCENE?set=section.key%3Dvalue&realtime=1``: the simulated rig as a pyserial port.

pyserial finds this module by its name once "rig_sim" stands in ``serial.protocol_handler_packages``; a recorder then
opens the URL as it opens /dev/ttyACM0 and never imports the simulator.  SCENE is a built-in name or the percent-encoded
path of a TOML file; ``set`` may be repeated.  Without ``realtime`` samples come as fast as they can be computed, and
only when somebody reads; with it at the pace of the wall clock.

What it does not simulate: baud rate and line errors, modem lines, unplugging.
"""

import threading
import time
from typing import Any
from urllib.parse import unquote

from serial.serialutil import PortNotOpenError, SerialBase, SerialException

from rig_sim.board.board import SimulatedBoard
from rig_sim.scenes.scene import parse_changes, scene
from stickslip.errors import InputError

_SCHEME = "rig://"
_SAMPLES_AT_ONCE = 1000  # or a quarter of a second, if that is less
_REALTIME_POLL_S = 0.005  # how often a waiting read looks at the wall clock


class Serial(SerialBase):  # type: ignore[misc, unused-ignore]
    """A pyserial port with a simulated rig at its other end; safe for one reading and one writing thread."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._board: SimulatedBoard | None = None
        self._buffer = bytearray()
        self._changed = threading.Condition()
        self._realtime = False
        self._wall_start = 0.0
        self._taken = 0
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """Build the scene and power the board up; raises SerialException where the port is open or not named."""
        if self.port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        name, changes, self._realtime = parse_url(self.port)
        self._board = SimulatedBoard(scene(name, **parse_changes(changes)))
        self._buffer[:] = self._board.power_up()
        self.is_open = True

    def close(self) -> None:
        with self._changed:
            self.is_open = False
            self._changed.notify_all()

    @property
    def in_waiting(self) -> int:
        with self._changed:
            self._fill(self._require_board())
            return len(self._buffer)

    def read(self, size: int = 1) -> bytes:
        """Return up to ``size`` bytes: as many as come before the timeout (None: wait for all of them)."""
        end = None if self.timeout is None else time.monotonic() + self.timeout
        with self._changed:
            board = self._require_board()
            while self.is_open:
                self._fill(board, size)
                remaining = None if end is None else end - time.monotonic()
                if len(self._buffer) >= size or (remaining is not None and remaining <= 0):
                    break
                self._changed.wait(self._choose_wait(board, remaining))
            data = bytes(self._buffer[:size])
            del self._buffer[:size]
        return data

    def write(self, data: Any, /) -> int:
        """Send the board commands; its answers follow in the stream."""
        sent = bytes(data)
        with self._changed:
            board = self._require_board()
            was_running = board.running
            self._buffer += board.write(sent)
            if board.running and not was_running:
                self._wall_start, self._taken = time.monotonic(), 0
            self._changed.notify_all()
        return len(sent)

    def flush(self) -> None:
        """Nothing waits to be sent: a write has arrived when it returns."""

    def reset_input_buffer(self) -> None:
        with self._changed:
            self._require_board()
            self._buffer.clear()

    def reset_output_buffer(self) -> None:
        """Nothing waits to be sent."""
        self._require_board()

    @property
    def out_waiting(self) -> int:
        """Nothing waits to be sent."""
        return 0

    def cancel_read(self) -> None:
        """Wake a waiting read; it keeps waiting unless the port was closed."""
        with self._changed:
            self._changed.notify_all()

    def _require_board(self) -> SimulatedBoard:
        if not self.is_open or self._board is None:
            raise PortNotOpenError()
        return self._board

    def _fill(self, board: SimulatedBoard, size: int = 1) -> None:
        """Compute samples until ``size`` bytes wait or, in real time, until the samples now due are there."""
        while board.running and len(self._buffer) < size:
            count = min(_SAMPLES_AT_ONCE, max(1, board.rate_hz // 4))
            if self._realtime:
                due = int((time.monotonic() - self._wall_start) * board.rate_hz) + 1
                count = min(count, due - self._taken)
                if count <= 0:
                    return
            self._taken += count
            self._buffer += board.samples(count)

    def _choose_wait(self, board: SimulatedBoard, remaining: float | None) -> float | None:
        if self._realtime and board.running:
            return _REALTIME_POLL_S if remaining is None else min(_REALTIME_POLL_S, remaining)
        return remaining

    # Modem lines and line settings mean nothing to the simulated rig; pyserial calls these when they are set.
    def _reconfigure_port(self) -> None: ...

    def _update_break_state(self) -> None: ...

    def _update_rts_state(self) -> None: ...

    def _update_dtr_state(self) -> None: ...

    cts = dsr = property(lambda self: True)  # clear to send, data set ready
    ri = cd = property(lambda self: False)  # ring indicator, carrier detect


def parse_url(url: str) -> tuple[str, list[str], bool]:
    """Return the scene, its changes and the ``realtime`` flag of a ``rig://`` URL."""
    if not url.lower().startswith(_SCHEME):
        raise InputError("is not a rig:// URL", url, "write rig://SCENE?set=section.key=value&realtime=1")
    name, _, query = url[len(_SCHEME) :].partition("?")
    name = unquote(name).rstrip("/")
    if not name:
        raise InputError("does not name a scene", url, "write rig://rig, or the percent-encoded path of a TOML file")
    changes: list[str] = []
    realtime = False
    for option in filter(None, query.split("&")):
        key, _, value = option.partition("=")
        value = unquote(value)
        if key == "set":
            changes.append(value)
        elif key == "realtime" and value in ("0", "1"):
            realtime = value == "1"
        else:
            raise InputError(
                f"unknown option {key}={value}", url, "the options are set=section.key=value and realtime=1"
            )
    return name, changes, realtime
