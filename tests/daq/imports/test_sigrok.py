"""Captures: the container read whatever its chunks, real ones decoded to the counts stated for them."""

import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from daq.cli.app import app
from daq.imports import capture, sigrok
from daq.imports.options import ProbeOptions
from daq.wire.quadrature import GRAY
from stickslip.console import application
from stickslip.errors import InputError


def walk_up_and_down(up, down):
    """Return A, B levels of ``up`` x4 counts up, then ``down`` down, two samples each."""
    count = np.concatenate((np.arange(up + 1), up - 1 - np.arange(down)))
    return np.repeat(GRAY[count & 3].astype(np.int64), 2)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "capture.sr"


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), unitsize=st.integers(1, 4))
def test_every_probe_reads_back_whatever_the_chunks(path, data, unitsize, write_capture):
    samples = data.draw(hnp.arrays(np.uint64, st.integers(1, 60), elements=st.integers(0, 256**unitsize - 1)))
    chunk = data.draw(st.none() | st.integers(1, 20))
    bits = data.draw(st.lists(st.integers(0, 8 * unitsize - 1), min_size=2, max_size=2, unique=True))
    probes = {bit: f"D{bit}" for bit in range(8 * unitsize)}
    found = sigrok.read(write_capture(path, samples, probes, unitsize=unitsize, chunk=chunk))
    assert found.samples == samples.size
    levels = np.concatenate(list(found.levels(*bits)))
    wanted = (samples >> np.uint64(bits[0]) & np.uint64(1)) + 2 * (samples >> np.uint64(bits[1]) & np.uint64(1))
    np.testing.assert_array_equal(levels, wanted)


@pytest.mark.parametrize(
    ("text", "hertz"),
    [("1 MHz", 1e6), ("12 MHz", 12e6), ("500 kHz", 5e5), ("20000", 2e4), ("1.5 GHz", 1.5e9), (None, None)],
)
def test_the_rate_is_read_and_never_guessed(path, text, hertz, write_capture):
    assert sigrok.read(write_capture(path, [0, 1], {0: "A"}, rate=text)).rate_hz == hertz


def test_probes_are_called_by_name_before_index(path, write_capture):
    found = sigrok.read(write_capture(path, [0, 1], {0: "1", 1: "0", 2: "XA", 5: "XB"}))
    assert [found.bit(name, "--step") for name in ("1", "0", "XA", "2", "5")] == [0, 1, 2, 2, 5]


def totals(path, decoder=None, **probes):
    found = sigrok.read(path)
    wired = capture.choose_wiring(found, ProbeOptions(**probes, decoder=decoder))
    return capture.decode(found, wired)


@pytest.mark.parametrize("chunk", [None, 1, 7])
def test_a_known_walk_counts_as_walked(path, chunk, write_capture):
    write_capture(path, walk_up_and_down(101, 60) << 3, {3: "A", 4: "B"}, chunk=chunk)
    assert totals(path, channels="A=A,B=B") == capture.Totals(101, 60, 41, 0, 161)
    assert totals(path, channels="B=A,A=B") == capture.Totals(60, 101, -41, 0, 161)


METADATA = "[device 1]\ncapturefile=logic-1\nsamplerate=1 MHz\nunitsize=1\nprobe1=A\nprobe2=B\n"
BYTES = bytes([0, 1, 3, 2] * 250)


def zipped(metadata=METADATA, entry="logic-1", packed=zipfile.ZIP_DEFLATED):
    """Return a capture of these metadata, whose samples are in this entry."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("version", "2")
        if metadata is not None:
            archive.writestr("metadata", metadata)
        archive.writestr(entry, BYTES, packed)
    return made.getvalue()


def changed(at, data):
    whole = bytearray(zipped())
    whole[at : at + len(data)] = data
    return bytes(whole)


WHOLE = zipped()
END, DIRECTORY = WHOLE.rindex(b"PK\x05\x06"), WHOLE.rindex(b"PK\x01\x02")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        (b"G1 X10", "not a zip"),
        (zipped(None), "without 'metadata'"),
        (zipped("no section\n"), "broken metadata"),
        (zipped("[global]\n[device 1]\ntotal analog=1\nanalog1=V\n"), "no logic samples"),
        (zipped(METADATA.replace("logic-1", "logic-7")), "no logic-7"),
        (zipped("[device 1]\ncapturefile=logic-1\n"), "no probe names"),
        (zipped(METADATA.replace("unitsize=1", "unitsize=0")), "unitsize = '0'"),
        (zipped(METADATA.replace("unitsize=1", "unitsize=16")), "ends within a sample"),
        (zipped(METADATA.replace("1 MHz", "fast")), "samplerate = 'fast'"),
        (zipped(METADATA.replace("1 MHz", "9" * 400)), "samplerate"),  # times that were not numbers
        # Small files that claim much.
        (zipped(entry="logic-1-3000000000"), "no logic samples"),  # took 4.5 GB
        (zipped(entry="logic-1-300000000"), "lacks logic-1-1 of"),
        (zipped(entry="logic-1-01"), "no logic samples"),  # a KeyError
        (zipped(METADATA.replace("unitsize=1", f"unitsize={'9' * 5000}")), "unitsize"),  # a ValueError
        (zipped(METADATA + f"probe{'9' * 5000}=C\n" + ";" * 2_000_000), "of metadata"),
        # What no logic analyser packs: damage in it was a traceback, and its header may ask for 4 GB of memory.
        (zipped(packed=zipfile.ZIP_LZMA), "uses a compression"),
        # Damage: of samples, of the directory's place (an OSError), of a name that is no UTF-8 (a UnicodeDecodeError).
        (WHOLE[: len(WHOLE) // 2], "damaged or cut short"),
        (changed(WHOLE.index(b"logic-1") + 8, b"\xff" * 4), "damaged or cut short"),
        (changed(END + 16, b"\xff\xff"), "damaged or cut short"),
        (changed(DIRECTORY + 9, b"\x08" + WHOLE[DIRECTORY + 10 : DIRECTORY + 46] + b"\x90"), "damaged or cut short"),
    ],
)
def test_what_is_no_whole_capture_is_named(path, content, words):
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as error:
        totals(path, channels="A=0,B=1")
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)
    assert words in str(error.value)


def test_a_chunk_that_is_missing_is_named(path, write_capture):
    write_capture(path, np.arange(100), {0: "A", 1: "B"}, chunk=10)
    with zipfile.ZipFile(path) as archive:
        kept = {name: archive.read(name) for name in archive.namelist() if name != "logic-1-4"}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in kept.items():
            archive.writestr(name, data)
    with pytest.raises(InputError, match="lacks logic-1-4"):
        totals(path, channels="A=0,B=1")


def test_a_mouse_moves_by_the_stated_edges(captures):
    found = totals(captures / "avago_adns_2051_move_mouse_left_right.sr", channels="A=XA,B=XB")
    assert (found.edges, found.illegal, found.up + found.down) == (1041, 0, 1041)


@pytest.mark.parametrize(("step", "direction"), [("3", "4"), ("5", "6")])
def test_a_motion_controller_steps_there_and_back(captures, step, direction):
    found = totals(captures / "smoothieware.sr", step=step, direction=direction)
    assert found == capture.Totals(16_000, 16_000, 0, 0, 32_000)


@pytest.mark.parametrize(
    ("samples", "flags", "expected", "warned"),
    [
        (walk_up_and_down(8, 4), ["--decoder", "x1"], {"up": 2, "down": 1, "net": 1, "illegal": 0, "edges": 12}, []),
        ([0, 3, 0], [], {"illegal": 2}, ["2 illegal"]),  # a warning, no failure
    ],
)
def test_the_command_answers_in_json(path, capsys, write_capture, samples, flags, expected, warned):
    write_capture(path, samples, {0: "A", 1: "B"})
    assert application.run(app, ["decode", str(path), "--channels", "A=A,B=B", *flags, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed | expected == printed
    assert len(printed["warnings"]) == len(warned)
    assert all(words in found for words, found in zip(warned, printed["warnings"], strict=True))


def test_an_indented_key_is_no_part_of_a_probe_name(path, write_capture):
    write_capture(path, [0, 1, 3], {0: 'A "upper"\n\tinverted=no', 1: "B\n    samples=3"})
    assert sigrok.read(path).probes == {0: 'A "upper"', 1: "B"}
