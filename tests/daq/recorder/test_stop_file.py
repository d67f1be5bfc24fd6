"""A recording ends when a file beside its journal asks for it, as on the first Ctrl-C: complete, with its reason."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import daq
from daq.cli.record import rig_port
from daq.protocols.request import RecordRequest
from daq.recorder.record import record
from daq.runfile import journal, store


def test_a_file_beside_the_journal_ends_a_recording_and_its_data_are_kept(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    asked = tmp_path / "run.h5.stop"
    asked.touch()  # one that an earlier recording of this name has left ends nothing
    request = RecordRequest(port=rig_port(None, [], True), output=run, duration_s=600.0)

    def ask() -> None:
        while not request.part.exists() or request.part.stat().st_size < 12_000:
            time.sleep(0.02)
        assert not asked.exists()
        asked.touch()

    asking = threading.Thread(target=ask)
    asking.start()
    found = record(request)
    asking.join()
    assert (found.ended, found.lost, found.short) == (journal.STOPPED, 0, False)
    assert 0.5 < found.duration_s < 60.0
    assert store.load(run).time.size == found.samples
    assert not asked.exists()
    assert not request.part.exists()


def test_the_file_ends_a_recording_of_a_programs_blocks_too(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"

    def blocks() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for k in range(10_000):
            t = (100 * k + np.arange(100)) / 1000
            if k == 5:
                journal.stop_path(run).touch()
            if k >= 5:
                time.sleep(0.05)
            yield t, 0.01 * np.sin(6 * t)

    found = daq.record(blocks(), run, rate_hz=1000)
    assert found.ended == journal.STOPPED
    assert 500 <= found.samples < 5000
    assert store.load(run).time.size == found.samples
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.h5"]
