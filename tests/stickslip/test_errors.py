"""One message, two readers: flags on a terminal, keywords from Python."""

import copy
import pickle

import pytest

from stickslip.errors import InputError, in_python


def test_a_terminal_reads_flags_and_python_reads_keywords():
    error = InputError("is -1", "--max-steps", "give a positive number, or lower --until")
    assert error.as_line() == "--max-steps: is -1; give a positive number, or lower --until"
    assert error.as_json() == {
        "what": "is -1",
        "where": "--max-steps",
        "do": "give a positive number, or lower --until",
    }
    assert str(error) == "max_steps: is -1; give a positive number, or lower until"


@pytest.mark.parametrize(
    ("typed", "keyword"),
    [
        ("take --method=rk4-henon.", "take method='rk4-henon'."),
        ("(--jobs=2)", "(jobs=2)"),
        ("--window=20ms or --window=21", "window='20ms' or window=21"),
        ("--until=T", "until=T"),
        ("--rate 523 or less", "rate 523 or less"),
        ("--mass '1 kg' or --x0='-1 mm +- 0.1 mm'", "mass='1 kg' or x0='-1 mm +- 0.1 mm'"),
        ("a-b, a--b, ---, -o and x--until", "a-b, a--b, ---, -o and x--until"),
    ],
)
def test_a_flag_becomes_the_keyword_of_its_name(typed, keyword):
    assert in_python(typed) == keyword


def test_another_call_from_python_stands_in_place_of_what_to_type():
    call = "rig_sim.scene('rig', **{'friction.gamma': 9})"
    error = InputError("is 0", "friction.gamma", "write --set friction.gamma=9", python=f"write {call}")
    assert error.as_line() == "friction.gamma: is 0; write --set friction.gamma=9"
    assert str(error) == f"friction.gamma: is 0; write {call}"


def test_both_readings_survive_the_way_from_another_process():
    error = InputError("what", "--until", "type", python="call")
    error.add_result({"steps": 3}, ["3 steps"])
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert str(again) == str(error) == "until: what; call"
        assert again.as_line() == "--until: what; type"
        assert again.data == {"steps": 3}
