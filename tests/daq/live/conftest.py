"""Journals of recordings, kept after their run file was made."""

import shutil
from functools import cache

import pytest

from daq.cli.record import rig_port
from daq.protocols.request import RecordRequest
from daq.recorder.record import record
from daq.runfile import journal


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """Return a function that records a simulated rig with changes, once, into a folder with run.h5 and its journal."""
    remove = journal.Writer.remove

    def keep(writer):
        shutil.copy(writer.path, writer.path.with_name("kept"))
        remove(writer)

    @cache
    def make(*changes, duration_s=4.0):
        folder = tmp_path_factory.mktemp("recorded")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(journal.Writer, "remove", keep)
            record(RecordRequest(rig_port(None, list(changes), False), folder / "run.h5", duration_s=duration_s))
        (folder / "kept").rename(folder / "run.h5.part")
        return folder

    return make


@pytest.fixture
def keep_journal(recorded, tmp_path):
    """Return a function that gives the journal of such a recording, run.h5.part beside its run.h5."""

    def make(*changes, duration_s=4.0):
        shutil.copytree(recorded(*changes, duration_s=duration_s), tmp_path, dirs_exist_ok=True)
        return tmp_path / "run.h5.part"

    return make
