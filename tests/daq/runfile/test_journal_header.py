"""A journal's header, field by field: what cannot be true ends in an error that names the field, or does no harm."""

import json
import struct
import time
from dataclasses import replace
from pathlib import Path

import pytest

from daq.finalise.run import finalise, run_data
from daq.runfile import journal, store
from stickslip.errors import InputError, StickslipError
from stickslip.text import storable

from ...journals import write_journal

FIXTURE = Path(__file__).with_name("fixtures") / "clean.h5.part"
NOTES = {"columns": None, "decoder": None, "baud": None, "sample_name": "", "note": "", "tags": {}}
HUGE = 10**400
ABSURD = [
    *(None, True, -1, 0, 7, 1 << 70, HUGE, 1e-300, 1e300, float("nan"), float("inf")),
    *("", "text", "9" * 5000, "\0", "\ud800", [], ["text"], [[]]),
    *({}, {"a": "b"}, {"": "x"}, {"..": "x"}, {"a/b": "x"}, {"sha256_raw": "x"}, {"a": HUGE}, {"a": None}),
]


@pytest.fixture(scope="module")
def start():
    """Return the header of a recording, and its first records."""
    read = journal.read(FIXTURE)
    return NOTES | read.header, list(read.records)[:4]


def write(path, header, records):
    write_journal(path, [(record.kind, record.stamp_ns, record.data) for record in records], header)


def outcome(part):
    """Return the message of the error that finishing a journal ends in, "" without one; any other is a fault."""
    try:
        finalise(part, part.with_suffix(""), finished_by="test", force=True)
    except StickslipError as error:
        return str(error)
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*json.loads(FIXTURE.read_bytes()[33:].split(b"}}")[0] + b"}}"), *NOTES}))
def test_no_field_ends_in_a_traceback(tmp_path, start, name):
    header, records = start
    part = tmp_path / "run.h5.part"
    right = header[name]
    for value in ABSURD:
        write(part, header | {name: value}, records)
        said = outcome(part)
        assert name in said or not said or isinstance(value, type(right)), (value, said)
        assert said or not part.exists()
    write(part, {other: value for other, value in header.items() if other != name}, records)
    said = outcome(part)
    assert not said if name in (*NOTES, "pid", "host") else f"no {name}" in said


@pytest.mark.parametrize("text", ["a\0b", "r\udcfe.h5", "\ud800"])
def test_a_journal_is_built_whatever_its_texts_hold(tmp_path, start, text):
    # A NUL of a board, and the bytes of a folder that are no UTF-8, stand in journals of earlier versions.
    header, records = start
    odd = dict.fromkeys(("title", "operator", "sample_name", "note"), text)
    odd |= {"warnings": [text], "tags": {"tag": text}, "provenance": header["provenance"] | {"command_line": text}}
    part = tmp_path / "run.h5.part"
    configuration = replace(records[0], kind=journal.CONFIGURATION, data=b"# a\0b\n")
    write(part, header | odd, [configuration, *records])
    journal.markers_path(part).write_bytes(b"%d a\0b\n" % records[-1].stamp_ns)
    found = finalise(part, tmp_path / "run.h5", finished_by="test")
    run = store.load(tmp_path / "run.h5")
    held = storable(text)
    assert (run.title, run.operator, run.sample_name, run.note) == (held,) * 4
    assert (run.tags["tag"], run.provenance["command_line"], run.config_toml) == (held, held, "# a\\x00b\n")
    assert held in found.warnings
    assert r"a\x00b" in run.event_note


def test_a_record_of_dropped_bytes_longer_than_a_number_counts_nothing(tmp_path, start):
    # A number of 4800 digits was a traceback of `daq recover`.
    header, records = start
    part = tmp_path / "run.h5.part"
    odd = replace(records[-1], kind=journal.DROPPED, data=b"\xff" * 2000)
    write(part, header, [*records, odd])
    _, found = run_data(journal.read(part), [])
    assert found.dropped_bytes == 0


@pytest.mark.parametrize("text", [b"[" * 100_000, b"[]", b"{", b"7", b"\xff", b'{"rate_hz": ' + b"9" * 5000 + b"}"])
def test_a_header_that_is_no_json_object_is_refused(tmp_path, start, text):
    part = tmp_path / "run.h5.part"
    write(part, start[0], start[1])
    content = part.read_bytes()
    at = content.index(b"R", content.rindex(b'"provenance"'))
    part.write_bytes(journal.MAGIC + b"".join(journal.journal_records.pack(journal.HEADER, 0, text)) + content[at:])
    with pytest.raises(InputError, match="header"):
        journal.read(part)


@pytest.mark.parametrize("after", [b"", b"".join(journal.journal_records.pack(journal.LOST, 5, b""))])
def test_a_journal_that_claims_long_records_everywhere_costs_no_more_than_its_length(tmp_path, start, after):
    part = tmp_path / "run.h5.part"
    write(part, start[0], start[1])
    size, content = 120_000, bytearray()
    while len(content) < size:
        content += b"R" + struct.pack("<I", size - len(content)) + (bytes(8) + after if after else b"")
    part.write_bytes(part.read_bytes() + content)
    began = time.process_time()
    read = journal.read(part)
    assert time.process_time() - began < 1.5
    assert read.damaged + read.lost_tail > size / 3
