"""A recording ends when a file beside its journal asks for it, as on the first Ctrl-C: complete, with its reason."""

import threading
import time
from pathlib import Path

from daq.cli.record import rig_port
from daq.protocols.request import RecordRequest
from daq.recorder.record import record
from daq.runfile import journal, store


def test_a_file_beside_the_journal_ends_a_recording_and_its_data_are_kept(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    asked = journal.stop_path(run)
    asked.touch()  # one that an earlier recording of this name has left ends nothing
    request = RecordRequest(port=rig_port(None, [], True), output=run, duration_s=600.0)

    def ask() -> None:
        while not request.part.exists() or request.part.stat().st_size < 20_000:
            time.sleep(0.02)
        assert not asked.exists()
        asked.touch()

    asking = threading.Thread(target=ask)
    asking.start()
    found = record(request)
    asking.join()
    assert (found.ended, found.lost, found.short) == (journal.STOPPED, 0, False)
    assert 1.0 < found.duration_s < 60.0
    assert store.load(run).time.size == found.samples
    assert not asked.exists()
    assert not request.part.exists()


def test_a_request_to_stop_is_removed_with_its_journal(tmp_path: Path) -> None:
    assert (
        journal.stop_path(tmp_path / "run.h5.part")
        == journal.stop_path(tmp_path / "run.h5")
        == tmp_path / "run.h5.stop"
    )
