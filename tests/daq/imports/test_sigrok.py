"""Captures: the container read whatever its chunks, real ones decoded to the counts stated for them."""

import json
import zipfile
from pathlib import Path
from typing import Any

import cyclopts
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from daq.cli.app import app as commands
from daq.imports import capture, sigrok
from daq.imports.options import ProbeOptions
from daq.wire.quadrature import GRAY
from stickslip.console import application
from stickslip.errors import InputError


def walk_up_and_down(up: int, down: int) -> Any:
    """Return A, B levels of ``up`` x4 counts up, then ``down`` down, two samples each."""
    count = np.concatenate((np.arange(up + 1), up - 1 - np.arange(down)))
    return np.repeat(GRAY[count & 3].astype(np.int64), 2)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "capture.sr"


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), unitsize=st.integers(1, 4))
def test_every_probe_reads_back_whatever_the_chunks(
    path: Path, data: st.DataObject, unitsize: int, write_capture: Any
) -> None:
    samples = data.draw(hnp.arrays(np.uint64, st.integers(1, 60), elements=st.integers(0, 256**unitsize - 1)))
    chunk = data.draw(st.none() | st.integers(1, 20))
    bits = data.draw(st.lists(st.integers(0, 8 * unitsize - 1), min_size=2, max_size=2, unique=True))
    probes = {bit: f"D{bit}" for bit in range(8 * unitsize)}
    found = sigrok.read(write_capture(path, samples, probes, unitsize=unitsize, chunk=chunk))
    assert found.samples == samples.size
    levels = np.concatenate(list(found.levels(*bits)))
    wanted = (samples >> np.uint64(bits[0]) & np.uint64(1)) + 2 * (samples >> np.uint64(bits[1]) & np.uint64(1))
    np.testing.assert_array_equal(levels, wanted)


def test_chunks_follow_by_number_not_by_name(path: Path, write_capture: Any) -> None:
    found = sigrok.read(write_capture(path, np.arange(24), {0: "A"}, chunk=2))
    assert found.entries == tuple(f"logic-1-{number}" for number in range(1, 13))


@pytest.mark.parametrize(
    ("text", "hertz"),
    [("1 MHz", 1e6), ("12 MHz", 12e6), ("500 kHz", 5e5), ("20000", 2e4), ("1.5 GHz", 1.5e9), (None, None)],
)
def test_the_rate_is_read_and_never_guessed(
    path: Path, text: str | None, hertz: float | None, write_capture: Any
) -> None:
    assert sigrok.read(write_capture(path, [0, 1], {0: "A"}, rate=text)).rate_hz == hertz


def test_probes_are_called_by_name_before_index(path: Path, write_capture: Any) -> None:
    found = sigrok.read(write_capture(path, [0, 1], {0: "1", 1: "0", 2: "XA", 5: "XB"}))
    assert [found.bit(name, "--step") for name in ("1", "0", "XA", "2", "5")] == [0, 1, 2, 2, 5]


def test_an_unknown_probe_lists_the_captures(path: Path, write_capture: Any) -> None:
    found = sigrok.read(write_capture(path, [0, 1], {2: "XA", 5: "XB"}))
    for name in ("XC", "3"):
        with pytest.raises(InputError, match="2 XA, 5 XB") as error:
            found.bit(name, "--channels")
        assert name in error.value.as_line()


def totals(path: Path, decoder: str | None = None, **probes: str) -> capture.Totals:
    found = sigrok.read(path)
    wired = capture.choose_wiring(found, ProbeOptions(**probes, decoder=decoder))
    return capture.decode(found, wired)


@pytest.mark.parametrize("chunk", [None, 1, 7])
def test_a_known_walk_counts_as_walked(path: Path, chunk: int | None, write_capture: Any) -> None:
    write_capture(path, walk_up_and_down(101, 60) << 3, {3: "A", 4: "B"}, chunk=chunk)
    assert totals(path, channels="A=A,B=B") == capture.Totals(101, 60, 41, 0, 161)
    assert totals(path, channels="B=A,A=B") == capture.Totals(60, 101, -41, 0, 161)


def test_both_channels_at_once_are_illegal_and_not_counted(path: Path, write_capture: Any) -> None:
    write_capture(path, [0, 1, 3, 0, 1], {0: "A", 1: "B"})
    assert totals(path, channels="A=A,B=B") == capture.Totals(3, 0, 3, 1, 4)


def test_step_and_direction_count_rises(path: Path, write_capture: Any) -> None:
    step = np.array([1, 0, 1, 0, 1, 1, 0, 1, 0])  # high from the start: not seen to rise
    direction = np.array([1, 1, 1, 1, 1, 0, 0, 0, 0])
    write_capture(path, step + 2 * direction, {0: "step", 1: "dir"})
    assert totals(path, step="0", direction="dir") == capture.Totals(2, 1, 1, 0, 3)


@pytest.mark.parametrize(
    ("probes", "decoder", "words"),
    [
        ({}, None, ["which probes", "0 A, 1 B"]),
        ({"step": "A"}, None, ["which probes"]),
        ({"channels": "A=A,B=B", "step": "A"}, None, ["exclude"]),
        ({"channels": "A,B"}, None, ["'A,B'", "A=NAME,B=NAME"]),
        ({"channels": "A=A,C=B"}, None, ["does not name a pair"]),
        ({"channels": "A=A,B=A"}, None, ["same probe"]),
        ({"channels": "A=A,B=Q"}, None, ["no probe 'Q'"]),
        ({"channels": "A=A,B=B"}, "x2", ["'x2'", "--decoder"]),
        ({"step": "A", "direction": "A"}, None, ["same probe"]),
        ({"step": "A", "direction": "B"}, "x4", ["need no decoder"]),
    ],
)
def test_a_wrong_wiring_is_refused(
    path: Path, probes: Any, decoder: str | None, words: list[str], write_capture: Any
) -> None:
    write_capture(path, [0, 1], {0: "A", 1: "B"})
    with pytest.raises(InputError) as error:
        totals(path, decoder, **probes)
    for word in words:
        assert word in error.value.as_line()


def refused(path: Path) -> str:
    with pytest.raises(InputError) as error:
        totals(path, channels="A=0,B=1")
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    return str(error.value)


def rewritten(path: Path, **entries: bytes | None) -> None:
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    content |= {name.replace("_", "-"): data for name, data in entries.items()}  # type: ignore[dict-item]
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in content.items():
            if data is not None:
                archive.writestr(name, data)


def test_files_that_are_no_capture_are_named(path: Path, tmp_path: Path) -> None:
    assert "no such file" in refused(path)
    assert "folder" in refused(tmp_path)
    path.write_text("G1 X10")
    assert "not a zip" in refused(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme", "hello")
    assert "without 'metadata'" in refused(path)


def test_captures_that_lack_something_are_named(path: Path, write_capture: Any) -> None:
    whole = write_capture(path, np.arange(100), {0: "A", 1: "B"}, chunk=10).read_bytes()
    rewritten(path, logic_1_4=None)
    assert "lacks logic-1-4" in refused(path)
    path.write_bytes(whole)
    rewritten(path, metadata=b"[global]\nsigrok version=0.5\n[device 1]\ntotal analog=1\nanalog1=V\n")
    assert "no logic samples" in refused(path)
    rewritten(path, metadata=b"[device 1]\ncapturefile=logic-7\nprobe1=A\n")
    assert "no logic-7" in refused(path)
    rewritten(path, metadata=b"[device 1]\ncapturefile=logic-1\n")
    assert "names no probes" in refused(path)
    rewritten(path, metadata=b"[device 1]\ncapturefile=logic-1\nunitsize=0\nprobe1=A\n")
    assert "unitsize = '0'" in refused(path)
    rewritten(path, metadata=b"[device 1]\ncapturefile=logic-1\nunitsize=1\nsamplerate=fast\nprobe1=A\n")
    assert "samplerate = 'fast'" in refused(path)
    rewritten(path, metadata=b"no section\n")
    assert "broken metadata" in refused(path)
    write_capture(path, [], {0: "A", 1: "B"})
    assert "holds no logic samples" in refused(path)


def test_cut_and_damaged_captures_are_named(path: Path, write_capture: Any) -> None:
    rng = np.random.default_rng(1)
    whole = write_capture(path, rng.integers(0, 4, 5000), {0: "A", 1: "B"}).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert "damaged or cut short" in refused(path)
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 0xFF
    path.write_bytes(damaged)
    assert "damaged or cut short" in refused(path)
    write_capture(path, np.arange(11), {0: "A", 1: "B"})
    rewritten(path, metadata=b"[device 1]\ncapturefile=logic-1\nunitsize=2\nprobe1=A\nprobe2=B\n")
    assert "ends within a sample" in refused(path)


LEFT_RIGHT = "avago_adns_2051_move_mouse_left_right.sr"
UP_DOWN = "avago_adns_2051_move_mouse_up_down.sr"


@pytest.mark.parametrize(("name", "channels", "edges"), [(LEFT_RIGHT, "A=XA,B=XB", 1041), (UP_DOWN, "A=YA,B=YB", 629)])
def test_a_mouse_moves_by_the_stated_edges(captures: Path, name: str, channels: str, edges: int) -> None:
    found = totals(captures / name, channels=channels)
    assert found.edges == edges
    assert found.illegal == 0
    assert found.up + found.down == edges


@pytest.mark.parametrize(("step", "direction"), [("3", "4"), ("5", "6")])
def test_a_motion_controller_steps_there_and_back(captures: Path, step: str, direction: str) -> None:
    found = totals(captures / "smoothieware.sr", step=step, direction=direction)
    assert found == capture.Totals(16_000, 16_000, 0, 0, 32_000)


@pytest.fixture
def app() -> cyclopts.App:
    return commands


def test_the_command_answers_in_json(
    path: Path, app: cyclopts.App, capsys: pytest.CaptureFixture[str], write_capture: Any
) -> None:
    write_capture(path, walk_up_and_down(8, 4), {0: "A", 1: "B"})
    assert application.run(app, ["decode", str(path), "--channels", "A=A,B=B", "--decoder", "x1", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {key: printed[key] for key in ("up", "down", "net", "illegal", "edges")} == {
        "up": 2,
        "down": 1,
        "net": 1,
        "illegal": 0,
        "edges": 12,
    }


def test_illegal_transitions_are_a_warning_not_a_failure(
    path: Path, app: cyclopts.App, capsys: pytest.CaptureFixture[str], write_capture: Any
) -> None:
    write_capture(path, [0, 3, 0], {0: "A", 1: "B"})
    assert application.run(app, ["decode", str(path), "--channels", "A=A,B=B"]) == 0
    assert "warning: 2 illegal" in capsys.readouterr().out


def test_an_indented_key_is_no_part_of_a_probe_name(path: Path, write_capture: Any) -> None:
    # 13 of 1015 public captures have such metadata; the keys used to be part of the name above them.
    write_capture(path, [0, 1, 3], {0: 'A "upper"\n\tinverted=no', 1: "B\n    samples=3"})
    assert sigrok.read(path).probes == {0: 'A "upper"', 1: "B"}


METADATA = "[device 1]\ncapturefile=logic-1\nsamplerate=1 MHz\nunitsize=1\nprobe1=A\nprobe2=B\n"


@pytest.mark.parametrize(
    ("metadata", "entry", "what"),
    [
        (METADATA, "logic-1-3000000000", "no logic samples"),  # took 4.5 GB
        (METADATA, "logic-1-300000000", "lacks logic-1-1 of"),
        (METADATA, "logic-1-01", "no logic samples"),  # a KeyError
        (METADATA.replace("unitsize=1", f"unitsize={'9' * 5000}"), "logic-1", "unitsize"),  # a ValueError
        (METADATA + f"probe{'9' * 5000}=C\n" + ";" * 2_000_000, "logic-1", "of metadata"),
        (METADATA.replace("1 MHz", "9" * 400), "logic-1", "samplerate"),  # times that were not numbers
        (METADATA.replace("1 MHz", "0.0"), "logic-1", "samplerate"),
    ],
)
def test_small_files_that_claim_much_are_refused_at_once(path: Path, metadata: str, entry: str, what: str) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("version", "2")
        archive.writestr("metadata", metadata)
        archive.writestr(entry, bytes(1000))
    with pytest.raises(InputError, match=what):
        sigrok.read(path)


@pytest.mark.parametrize("packed", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_what_no_logic_analyser_packs_is_refused(path: Path, packed: int) -> None:
    # Damage in such an entry was a traceback, and its header may ask for 4 GB of memory.
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", METADATA)
        archive.writestr("logic-1", bytes(1000), packed)
    with pytest.raises(InputError, match="packed in a way"):
        sigrok.read(path)


def test_a_damaged_directory_of_the_zip_is_named(path: Path) -> None:
    # An entry before the beginning of the file was an OSError, a name that is no UTF-8 a UnicodeDecodeError.
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", METADATA)
        archive.writestr("logic-1", bytes(1000))
    content = path.read_bytes()
    end = content.rindex(b"PK\x05\x06")
    for place, changed in ((end + 16, b"\xff\xff"), (content.rindex(b"logic"), b"\x90")):
        damaged = bytearray(content)
        damaged[place : place + len(changed)] = changed
        directory = content.rindex(b"PK\x01\x02")
        damaged[directory + 9] |= 8 if changed == b"\x90" else 0  # names are UTF-8
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged or cut short"):
            sigrok.read(path)
