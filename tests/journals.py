"""Journals as a recorder writes them, of any records."""

from daq.runfile import journal

HEADER = {
    **{"protocol": "text", "columns": "t_us,count", "decoder": None, "port": "/dev/ttyACM0", "baud": 115_200},
    **{"rate_hz": 1000.0, "samples": None, "title": "a sketch", "operator": "", "sample_name": "", "note": ""},
    **{"tags": {}, "warnings": [], "provenance": {}},
    **{"wall_ns": 1_700_000_000_000_000_000, "monotonic_ns": 0, "utc_offset_s": 0},
}


def write_journal(part, records=(), header=HEADER):
    """Write the journal of records, each its kind, stamp in ns and bytes; return its path."""
    part.unlink(missing_ok=True)
    writer = journal.Writer(part, header)
    for record in records:
        writer.append(*record)
    writer.close()
    return part
