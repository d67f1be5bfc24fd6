"""Who may finish or remove a journal."""

import time

import pytest

from daq.finalise import claim
from daq.runfile import journal, journal_records
from stickslip.errors import InputError

from ...journals import HEADER, write_journal


def test_only_a_journal_without_received_bytes_makes_way(tmp_path):
    # One that was left before its header was whole used to block the name until somebody deleted it.
    written = write_journal(tmp_path / "run.h5.part", [(journal.RECEIVED, 10, b"abc")])
    whole = written.read_bytes()
    received = next(
        place.at for place in journal_records.scan(journal.Content(whole)) if place.record.kind == journal.RECEIVED
    )
    for size in (0, 5, len(journal.MAGIC), len(journal.MAGIC) + 7, received):
        written.write_bytes(whole[:size])
        assert claim.remove_empty(written), size
    for content in (whole, whole[: received + 1], b"precious", whole[:30] + b"x" + whole[31:]):
        written.write_bytes(content)
        assert not claim.remove_empty(written)
        assert written.read_bytes() == content


def test_a_journal_is_locked_while_it_is_written_and_free_when_its_writer_is_gone(tmp_path):
    path = tmp_path / "run.h5.part"
    header = HEADER | {"wall_ns": time.time_ns(), "pid": 4711, "host": "lab"}
    writer = journal.Writer(path, header)
    assert claim.is_locked(path)
    assert journal.read(path).header == header  # whoever only reads may
    with pytest.raises(InputError, match="process 4711 on lab"), claim.claim_journal(path):
        pytest.fail("the journal was given to somebody else")
    writer.close()
    assert not claim.is_locked(path)
    with claim.claim_journal(path) as remove:
        assert claim.is_locked(path)
        remove()
    assert not path.exists()
