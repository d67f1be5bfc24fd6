"""Journals of recordings, kept after their run file was made."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from daq.cli.record import rig_port
from daq.protocols.request import RecordRequest
from daq.recorder.record import record
from daq.runfile import journal


@pytest.fixture
def keep_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Return a function that records a simulated rig with changes and returns its journal, NAME.part.

    The run file, NAME, is beside it.
    """
    remove = journal.Writer.remove
    kept = tmp_path / "kept.part"

    def keep(writer: journal.Writer) -> None:
        shutil.copy(writer.path, kept)
        remove(writer)

    monkeypatch.setattr(journal.Writer, "remove", keep)

    def make(*changes: str, duration_s: float = 4.0) -> Path:
        run = tmp_path / "run.h5"
        record(RecordRequest(port=rig_port(None, list(changes), False), output=run, duration_s=duration_s))
        return kept.rename(tmp_path / "run.h5.part")

    return make
