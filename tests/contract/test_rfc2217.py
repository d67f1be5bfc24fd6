"""A board behind rfc2217://, served by pyserial's own server: an implementation that is not ours."""

import contextlib
import select
import socket
import sys
import threading

import numpy as np
import pytest
import serial
import serial.rfc2217

import daq
from daq.protocols.request import RecordRequest
from daq.recorder import ports
from daq.recorder.record import record

from ..boards import FakeFrames, motion

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are POSIX"),
    pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning"),  # pyserial's own
]


class Line(serial.Serial):
    """A pseudo-terminal as a serial line: it has no modem lines to ask for or to set."""

    cts = dsr = ri = cd = False

    def _update_dtr_state(self):
        """Do nothing."""

    _update_rts_state = _update_dtr_state


class Server(threading.Thread):
    """Forward one connection after another between a port and TCP, as pyserial's example of a server does."""

    def __init__(self, path):
        super().__init__(daemon=True)
        self._path = path
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"rfc2217://127.0.0.1:{self._listening.getsockname()[1]}"
        self._over = threading.Event()
        self.cut = threading.Event()  # ends the connection that is open
        self.connections = 0

    def run(self):
        self._listening.settimeout(0.05)
        while not self._over.is_set():
            with contextlib.suppress(TimeoutError):
                peer, _ = self._listening.accept()
                self.connections += 1
                self.cut.clear()
                with peer, Line(str(self._path), timeout=0) as port:
                    self._serve(peer, port)

    def _serve(self, peer, port):
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        class Writing:
            write = staticmethod(peer.sendall)

        manager = serial.rfc2217.PortManager(port, Writing)
        while not (self._over.is_set() or self.cut.is_set()):
            ready, _, _ = select.select([peer, port], [], [], 0.05)
            with contextlib.suppress(ConnectionError):
                if port in ready:
                    peer.sendall(b"".join(manager.escape(port.read(4096))))
                if peer in ready:
                    data = peer.recv(1024)
                    if not data:
                        return
                    port.write(b"".join(manager.filter(data)))

    def finish(self):
        self._over.set()
        self.join(5)
        self._listening.close()


@pytest.fixture
def served(tmp_path):
    with FakeFrames(tmp_path / "ttyFAKE", paced=True) as board:
        server = Server(board.path)
        server.start()
        yield server
        server.finish()


def test_a_port_behind_rfc2217_is_recorded(served, tmp_path):
    found = record(RecordRequest(served.url, tmp_path / "run.h5", duration_s=0.5))
    run = daq.load(tmp_path / "run.h5")
    assert (found.samples, found.lost, found.crc_errors, found.segments) == (500, 0, 0, 1)
    assert np.array_equal(run.count - run.count[0], motion(np.arange(500)) - motion(0))


def test_the_baud_rate_of_the_line_behind_rfc2217_counts(served):
    with ports.open_port(served.url, 57_600) as port:
        assert ports.line_baud(served.url, port) == 57_600
        assert ports.uart_baud(served.url, port) is None


@pytest.mark.slow
def test_a_connection_that_breaks_is_made_again(served, tmp_path):
    cutting = threading.Timer(2.0, served.cut.set)
    cutting.start()
    said = []
    found = record(RecordRequest(served.url, tmp_path / "run.h5", duration_s=5.0), say=said.append)
    cutting.join()
    run = daq.load(tmp_path / "run.h5")
    assert (found.segments, served.connections) == (2, 2)
    assert any("Waiting up to" in line for line in said)
    first = int(np.searchsorted(run.segment, 1))
    for part in (slice(0, first), slice(first, None)):
        k = np.round((run.time[part] - run.time[part][0]) * 1000).astype(int)
        assert np.ptp(run.count[part] - motion(k)) == 0
    assert found.samples > 3000
