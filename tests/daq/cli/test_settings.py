"""Settings: flag > environment > rig.toml > user config > default, each level shown to beat the next."""

import pytest

from daq.cli import settings
from daq.runfile.rig import Rig
from stickslip.errors import InputError


def resolve(**flags):
    """Resolve the settings of a command with these flags."""
    return settings.resolve(settings.BoardFlags(**flags))


@pytest.fixture(autouse=True)
def alone(monkeypatch, tmp_path):
    """Keep the tester's own environment out."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for key in (*settings.KEYS, "rig"):
        monkeypatch.delenv(f"STICKSLIP_{key.upper()}", raising=False)


@pytest.fixture
def places(monkeypatch, tmp_path):
    """Give every place a port and a rate of its own, and return the rig.toml."""
    rig = tmp_path / "rig.toml"
    rig.write_text('[rig]\nmass = 0.3\n[board]\nport = "from rig"\nrate = 3\n')
    user = tmp_path / "config" / "stickslip" / "config.toml"
    user.parent.mkdir(parents=True)
    user.write_text('[board]\nport = "from user"\nrate = 4\nbaud = 9600\n')
    monkeypatch.setenv("STICKSLIP_PORT", "from environment")
    monkeypatch.setenv("STICKSLIP_RATE", "2")
    return rig


def test_each_place_beats_the_next(places, monkeypatch):
    found = resolve(rig=places, port="from flag", rate=1)
    assert (found["port"], found["rate_hz"]) == ("from flag", 1)
    found = resolve(rig=places)
    assert (found["port"], found["rate_hz"]) == ("from environment", 2)
    monkeypatch.delenv("STICKSLIP_PORT")
    monkeypatch.delenv("STICKSLIP_RATE")
    found = resolve(rig=places)
    assert (found["port"], found["rate_hz"], found["baud"]) == ("from rig", 3, 9600)
    assert resolve()["port"] == "from user"


def test_the_rig_file_itself_may_come_from_the_environment(places, monkeypatch):
    monkeypatch.setenv("STICKSLIP_RIG", str(places))
    found = resolve()
    assert found["calibration"] == places.read_text()
    assert Rig.from_toml(found["calibration"], "x").mass.value == 0.3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[board]\nprot = 1\n", "did you mean 'port'"),
        ("[board]\nrate = 1.5\n", "whole number"),
        ("[board]\nport = 7\n", "text in quotes"),
        ("board = 1\n", "a value, not a section"),
        ("[board\n", "invalid TOML"),
    ],
)
def test_what_is_wrong_with_a_rig_file_is_named(tmp_path, text, said):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        resolve(rig=path)
    assert caught.value.where == str(path)


def test_a_missing_rig_file_and_a_word_for_a_number_are_named(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no such file"):
        resolve(rig=tmp_path / "none.toml")
    monkeypatch.setenv("STICKSLIP_BAUD", "fast")
    with pytest.raises(InputError, match="STICKSLIP_BAUD"):
        resolve()


def test_a_section_that_is_written_is_read_back():
    text = settings.format_board({"port": 'C:\\"x"', "protocol": "qsb", "baud": 230_400, "rate_hz": 500})
    assert settings.read_board_section(text, "x") == {
        "port": 'C:\\"x"',
        "protocol": "qsb",
        "baud": 230_400,
        "rate": 500,
    }


@pytest.mark.parametrize("value", ["", "config", "."])
def test_a_user_config_is_never_looked_for_in_the_current_folder(tmp_path, monkeypatch, value):
    # A relative XDG_CONFIG_HOME read the port and the rate from the folder of the data.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CONFIG_HOME", value)
    for folder in (tmp_path, tmp_path / "config"):
        (folder / "stickslip").mkdir(parents=True)
        (folder / "stickslip" / "config.toml").write_text('[board]\nport = "theirs"\n')
    assert resolve() == {}
