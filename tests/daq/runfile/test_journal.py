"""The journal: whatever the tail looks like after a crash, the records before it come back."""

import os
import stat

import pytest

from daq.runfile import journal
from stickslip.errors import InputError

from ...journals import HEADER, write_journal

RECORDS = [
    (journal.RECEIVED, 10, b"abc"),
    (journal.LOST, 20, b"unplugged"),
    (journal.REOPENED, 30, b""),
    (journal.RECEIVED, 40, bytes(range(256))),
    (journal.END, 50, b"{}"),
]


@pytest.fixture
def written(tmp_path):
    return write_journal(tmp_path / "run.h5.part", RECORDS)


def as_tuples(read):
    return [(record.kind, record.stamp_ns, record.data) for record in read.records]


def test_cut_at_every_byte_it_gives_the_records_before_the_cut(written):
    whole = written.read_bytes()
    ends, at = [], len(whole)
    for _, _, data in reversed(RECORDS):
        ends.append(at)
        at -= 13 + len(data) + 4
    ends.append(at)
    ends.reverse()
    header = len(journal.MAGIC) + (ends[0] - len(journal.MAGIC)) // 2  # the end of its first copy
    for cut in range(len(whole)):
        written.write_bytes(whole[:cut])
        if cut < header:
            with pytest.raises(InputError):
                journal.read(written)
            continue
        complete = sum(end <= cut for end in ends) - 1
        read = journal.read(written)
        assert as_tuples(read) == RECORDS[: max(0, complete)]
        assert read.lost_tail == cut - (ends[complete] if complete >= 0 else header)


@pytest.mark.parametrize("number", range(len(RECORDS)))
def test_a_damaged_record_costs_itself_alone(written, number):
    content = bytearray(written.read_bytes())
    at = len(content) - sum(13 + len(data) + 4 for _, _, data in RECORDS[number:])
    size = 13 + len(RECORDS[number][2]) + 4
    content[at + size // 2] ^= 1
    written.write_bytes(content)
    read = journal.read(written)
    assert [record for record in as_tuples(read) if record in RECORDS] == [*RECORDS[:number], *RECORDS[number + 1 :]]
    assert read.damaged + read.lost_tail == size


def test_received_bytes_of_a_damaged_record_are_kept_for_their_frames(written):
    content = bytearray(written.read_bytes())
    content[content.index(bytes(range(256))) + 100] ^= 1
    written.write_bytes(content)
    kinds = [record.kind for record in journal.read(written).records]
    assert kinds == [kind for kind, _, _ in RECORDS]
    assert journal.read(written).damaged == 13 + 256 + 4


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"t,x\n0,1\n", "not a journal"),
        (b"", "no record"),
        (journal.MAGIC, "no record"),
        (journal.MAGIC + b"H", "1 byte|because it is cut short"),
    ],
)
def test_what_is_no_journal_is_refused(tmp_path, content, said):
    path = tmp_path / "x.h5.part"
    with pytest.raises(InputError, match=r"x\.h5\.part: no such file"):
        journal.read(path)
    path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        journal.read(path)


def test_markers_are_read_in_order_and_torn_lines_left_out(tmp_path):
    path = tmp_path / "run.h5.markers"
    assert journal.read_markers(path) == ()
    path.write_text("300 belt off\n100 belt on\n\nnonsense\n40", encoding="utf-8")
    assert journal.read_markers(path) == ((40, ""), (100, "belt on"), (300, "belt off"))
    assert journal.markers_path(tmp_path / "run.h5.part") == path
    assert journal.markers_path(tmp_path / "run.h5") == path


def test_one_wrong_byte_in_the_header_costs_nothing(written):
    whole = written.read_bytes()
    right = journal.read(written)
    header, records = right.header, as_tuples(right)  # now: they are read from the file
    end = len(journal.MAGIC) + 13 + int.from_bytes(whole[21:25], "little") + 4
    assert whole[20:21] == b"H"
    for at in [*range(40), *range(40, end, 1 + end // 40), *range(end - 5, end)]:
        for flip in (0x01, 0x80, 0xFF):
            written.write_bytes(whole[:at] + bytes([whole[at] ^ flip]) + whole[at + 1 :])
            read = journal.read(written)
            assert (read.header, as_tuples(read)) == (header, records), (at, flip)
            assert read.damaged > 0  # so the journal is kept


def test_the_header_comes_again_so_that_the_loss_of_the_beginning_costs_only_that(tmp_path):
    path = write_journal(tmp_path / "run.h5.part", [(journal.RECEIVED, stamp, bytes(1000)) for stamp in range(200)])
    content = path.read_bytes()
    path.write_bytes(content[:16] + bytes(4096 - 16) + content[4096:])
    read = journal.read(path)
    assert read.header == HEADER
    assert 190 < len(read.records) < 200
    assert len(content) < 1.05 * 200 * 1017


def test_a_journal_whose_header_is_beyond_repair_is_to_be_kept(written):
    content = bytearray(written.read_bytes())
    for at in [i for i in range(len(content)) if content.startswith(b'{"protocol"', i)]:
        content[at : at + 20] = bytes(20)
    written.write_bytes(content)
    with pytest.raises(InputError, match=r"2 records of received bytes.*keep it") as caught:
        journal.read(written)
    assert "delete" not in str(caught.value)


def test_the_name_of_a_new_journal_is_on_the_disk(tmp_path, monkeypatch):
    # Without this a power cut in the first seconds left a file that no folder named.
    synced = []
    real = os.fsync

    def fsync(handle):
        synced.append(stat.S_ISDIR(os.fstat(handle).st_mode))
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    journal.Writer(tmp_path / "run.h5.part", {}).close()
    assert True in synced
