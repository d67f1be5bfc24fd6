"""Files that continue a long computation: what they keep, and what they refuse."""

import pytest

from rig_sim.results.resume import open_resume_file
from stickslip.errors import InputError

HEADER = {"command": "count", "step": {"size": 0.1}}
ROWS = [{"value": 0.1 + 0.2}, {"value": 1e-300}, {"value": 5e-324}]


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "rows.jsonl"
    with open_resume_file(path, HEADER) as file:
        for row in ROWS:
            file.append(row)
    return path


def rows_in(path):
    with open_resume_file(path, HEADER) as file:
        return file.rows


def test_rows_come_back_to_the_last_bit_and_a_cut_line_is_dropped(path):
    """Every length that a killed process can leave gives the rows that are whole, and can be continued."""
    content = path.read_bytes()
    ends = [index + 1 for index, byte in enumerate(content) if byte == ord("\n")]
    for size in range(len(content) + 1):
        path.write_bytes(content[:size])
        with open_resume_file(path, HEADER) as file:
            whole = sum(end <= size for end in ends[1:])
            assert file.rows == ROWS[:whole]
            for row in ROWS[whole:]:
                file.append(row)
        assert path.read_bytes() == content


def test_a_file_to_which_nothing_was_written_does_not_stay(tmp_path):
    assert rows_in(tmp_path / "rows.jsonl") == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"time,x\n0,1\n", "was not written by this command"),
        (b"\x89PNG without an end of line", "was not written by this command"),
        (b'{"rows": []}\n', "was not written by this command"),
        (b'{"command": "count", "step": {"size": 0.2}}\n', r"step\.size is 0\.2 there, but 0\.1 here"),
        (b'{"command": "count"}\n', "step is None there"),
        (b'{"command": "count", "step": {"size": 0.1}}\n{"value": 1}\n{"val\n{"value": 3}\n', "line 3 is damaged"),
    ],
)
def test_another_file_is_refused_and_stays_as_it_is(tmp_path, content, said):
    path = tmp_path / "other"
    path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        rows_in(path)
    assert path.read_bytes() == content


def test_a_file_that_another_process_writes_is_refused(path):
    with open_resume_file(path, HEADER), pytest.raises(InputError, match="another process is writing this file"):
        rows_in(path)
    assert rows_in(path) == ROWS
