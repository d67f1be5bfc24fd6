"""Who may finish or remove a journal."""

from daq.finalise import claim
from daq.runfile import journal, journal_records

from ...journals import write_journal


def test_only_a_journal_without_received_bytes_makes_way(tmp_path):
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
