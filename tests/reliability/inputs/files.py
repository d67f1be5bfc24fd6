"""Damaged files of every kind that a command reads: text, captures, MATLAB's, and run files."""

import functools
import io
import random
import string
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import savemat

from daq.cli import settings
from daq.imports import capture, replay, sigrok, table_to_run
from daq.imports.options import ImportOptions, ProbeOptions
from daq.runfile import listing, store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from daq.runfile.run_data import Raw
from processing import smoothing, stage
from rig_sim.scenes.scene import BUILTIN_FOLDER, parse_changes, scene
from stickslip.units import Measured

from .mutation import NUMBERS, bytewise, textual

RIG = Rig("bench", "x4", Measured(7.67e-6, 1e-9), 16384, 16, Measured(0.3, 1e-3), Measured(10.5), Measured(0.0, 1e-4))
AWKWARD = (0, -1, 1, 7, 2**31, 2**63 - 1, -(2**63), 1e300, -1e300, 1e-310, 1e12, float("nan"), float("inf"))
ZONES = [f"2024-05-01T12:00:{second:02}+02:00" for second in (0, 1)]


def damaged_toml(draw: random.Random, folder: Path) -> None:
    """Try a text as a rig, as the section of a board, as a scene, or as the value of --set."""
    content = textual(draw, draw.choice(tomls()), tomls())
    kind = draw.randrange(4)
    if kind == 0:
        (folder / "input.toml").write_bytes(content)
        scene(folder / "input.toml")
    elif kind == 1:
        value = draw.choice((*NUMBERS, content[:80], content.split(b"=")[-1])).decode(errors="replace")
        section = draw.choice(("mass.m", "friction", "friction.law", "seed", "belt.speed", "start.x", "friction.curve"))
        scene("base", **parse_changes([f"{section}={value}"]))
    elif kind == 2:
        settings.read_board_section(content.decode(errors="replace"), "input")
    else:
        rig = Rig.from_toml(content.decode(errors="replace"), "input")
        if Rig.from_toml(rig.to_toml(), "again") != rig:
            raise AssertionError("a rig reads back as another")


@functools.cache
def tomls() -> list[bytes]:
    board = b'[board]\nport = "/dev/ttyACM0"\nprotocol = "frames"\nrate = 1000\n'
    scenes = [path.read_bytes() for path in sorted(BUILTIN_FOLDER.glob("*.toml"))]
    return [RIG.to_toml().encode() + board, board, *scenes]


def damaged_csv(draw: random.Random, folder: Path) -> None:
    """Try a table that is almost one of those which cameras, spreadsheets and drives write."""
    path = folder / "input.csv"
    content = draw.choice(tables())
    for _ in range(draw.choice((1, 1, 2, 4))):
        content = textual(draw, content, tables())
    path.write_bytes(draw.choice((b"", b"", b"\xef\xbb\xbf", b"sep=;\n")) + content)
    table_to_run.read(path, draw.choice(_options()))


@functools.cache
def tables() -> list[bytes]:
    made = []
    for delimiter, decimal, head in (
        *((",", ".", "t,x"), (";", ",", "time (s);x (mm)"), ("\t", ".", "Frame\tx [cm]"), (" ", ".", "")),
        *((",", ".", "# camera\n\ntime,force (N),other"), (";", ".", "rate;400\nsweep;3\nt;x\ns;mm")),
    ):
        lines = [head] if head else []
        for k in range(20):
            values = [k / 100, 0.1 + 0.001 * k * (-1) ** k, 7.0][: 3 if "force" in head else 2]
            lines.append(delimiter.join(f"{value:.4f}".replace(".", decimal) for value in values))
        made.append("\n".join(lines).encode())
    made.append(b"clock,x\n" + b"".join(b"23:59:5%d.000,%d\n" % (k, k) for k in range(10)))
    made.append(made[0].decode().encode("utf-16"))
    return made


@functools.cache
def _options() -> list[ImportOptions]:
    given: list[dict[str, Any]] = [
        *({}, {}, {"x_unit": "mm", "t_unit": "s"}, {"frame_rate_hz": 400.0}, {"skip_bad": True}, {"preamble": 1}),
        *({"clock": True, "position": "2", "time": "1"}, {"position": "2", "skip_bad": True, "frame_rate_hz": 1e-3}),
        {"spring_force": "2", "stiffness": Measured(10.0), "time": "1", "force_unit": "N"},
        {"mass": Measured(0.3), "stiffness": Measured(10.0), "x_unit": "m", "t_unit": "s", "skip_bad": True},
    ]
    return [ImportOptions(**each) for each in given]


def damaged_mat(draw: random.Random, folder: Path) -> None:
    """Try a MATLAB file: damaged bytes, before they are compressed too, and variables of every type."""
    path = folder / "input.mat"
    content = draw.choice(mats())
    for _ in range(draw.choice((1, 1, 2))):
        content = bytewise(draw, content, mats())
    path.write_bytes(_recompressed(content) if draw.random() < 0.3 else content)
    table_to_run.read(path, draw.choice(_options()))


@functools.cache
def mats() -> list[bytes]:
    time = np.arange(40) / 100
    table = {"t": time, "x": np.sin(time)}
    nested = np.empty((1, 2), object)
    nested[0, 0], nested[0, 1] = time, {"a": "text", "b": {"c": time[:3]}}
    odd = {"s": {"x": time, "name": "text"}, "c": nested, "z": time * 1j}
    odd |= {"n": np.arange(9, dtype="i8"), "e": np.zeros((0, 3))}
    made = []
    for content in (table, odd | {"w": "text", "m": np.eye(3)}):
        for options in ({}, {"do_compression": True}, {"oned_as": "column"}):
            stream = io.BytesIO()
            savemat(stream, content, **options)
            made.append(stream.getvalue())
    stream = io.BytesIO()
    savemat(stream, table, format="4")
    return [*made, stream.getvalue()]


def _recompressed(content: bytes) -> bytes:
    # of level 5, as one compressed variable
    packed = zlib.compress(content[128:])
    return content[:128] + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed


def damaged_sr(draw: random.Random, folder: Path) -> None:
    """Try a capture: a damaged archive, and a sound one with damaged metadata or entries."""
    path = folder / "input.sr"
    metadata = METADATA if draw.random() < 0.4 else textual(draw, METADATA, [METADATA])
    samples = draw.choice(captures())
    with zipfile.ZipFile(path, "w", draw.choice((0, 8, 8, 8, 12, 14))) as archive:
        archive.writestr("version", "2")
        archive.writestr(draw.choice(("metadata",) * 9 + ("meta",)), metadata)
        for name in draw.choice(
            (("logic-1",), ("logic-1-1", "logic-1-2"), ("logic-1-2",), (), ("../logic-1", "logic-1"))
        ):
            archive.writestr(name, samples)
    if draw.random() < 0.6:
        path.write_bytes(bytewise(draw, path.read_bytes()))
    found = sigrok.read(path)
    wired = capture.choose_wiring(found, ProbeOptions(channels=draw.choice(("A=A,B=B", "A=0,B=1"))))
    capture.decode(found, wired)
    rate = found.rate_hz if found.rate_hz else 1e6
    replay.sample_capture(found, wired, min(1000.0, rate), Rig())


@functools.cache
def captures() -> list[bytes]:
    return [bytes(k // 3 % 4 for k in range(size)) for size in (0, 1, 300, 5000)]


METADATA = (
    b"[global]\nsigrok version=0.5.2\n\n[device 1]\ncapturefile=logic-1\ntotal probes=2\nsamplerate=1 MHz\n"
    b"probe1=A\nprobe2=B\nunitsize=1\n"
)


def damaged_h5(draw: random.Random, folder: Path) -> None:
    """Try a run file as every command reads it: damaged bytes, or sound HDF5 with awkward values, types and objects."""
    path = folder / "input.h5"
    for left in folder.iterdir():
        left.unlink()
    sound = runs()
    if draw.random() < 0.6:
        name = draw.choice(list(sound))
        content, used = sound[name]
        made = bytearray(content)
        for _ in range(draw.choice((1, 1, 1, 2, 4))):
            at = draw.choice(used)
            made[at] = draw.choice((0, 255, made[at] ^ 1 << draw.randrange(8), draw.randrange(256), made[at] ^ 255))
        path.write_bytes(made if draw.random() < 0.97 else made[: draw.randrange(len(made))])
    else:
        path.write_bytes(_restructured(draw, sound[draw.choice(list(sound))][0]))
    _use(draw, path)


def _use(draw: random.Random, path: Path) -> None:
    run = store.load(path)
    match draw.randrange(16):
        case 0:
            smoothing.smooth(run)
        case 1 | 2:
            store.annotate(path, {"title": "again", "tags": {"a": "b"}}, [(0.1, "mark")])
            store.load(path)
        case 3 | 4:
            store.extend(path, "smooth", lambda entry: entry.create_group("smooth"))
            store.load(path)
        case 5 | 6:
            replay.decode_run(path)
        case 7 | 8:
            listing.list_runs([path.parent])
        case 9 | 10:
            stage.load_statistics(path)
        case _:
            stage.load(path)


@functools.cache
def runs() -> dict[str, tuple[bytes, list[int]]]:
    """Return run files, each with the places of its bytes outside of chunks: those are guarded by checksums."""
    time = np.arange(300) / 1000
    count = np.round(4000 * np.sin(9 * time)).astype(np.int64)
    raw = Raw(
        *(np.arange(300, dtype=np.uint32), (count & 0xFFFF).astype(np.uint16), np.zeros(300, np.uint16)),
        *((time * 1e6).astype(np.uint32), np.zeros(300, np.uint8), np.zeros(300, np.uint16), np.zeros(300, np.uint16)),
    )
    plain = Recording("a track", *ZONES, rate_hz=1000.0, rig=RIG, time=time, position=count * 7.67e-6)
    whole = Recording(
        **vars(plain)
        | {"count": count, "raw": raw, "operator": "me", "note": "text", "tags": {"a": "b"}}
        | {"event_sample": np.array([3, 7], np.uint32), "event_kind": ("gap", "marker"), "event_note": ("", "here")}
        | {"provenance": {"port": "x", "pid": 7}}
    )
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, run in (("import", plain), ("record", whole)):
            path = Path(folder) / f"{name}.h5"
            store.write(path, run)
            found[name] = _with_places(path)
            smoothing.smooth_file(path, "sg", 11)
            found[f"{name} smoothed"] = _with_places(path)
    return found


def _with_places(path: Path) -> tuple[bytes, list[int]]:
    content, chunks = path.read_bytes(), set()

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.chunks:
            for k in range(item.id.get_num_chunks()):
                chunk = item.id.get_chunk_info(k)
                chunks.update(range(chunk.byte_offset, chunk.byte_offset + chunk.size))

    with h5py.File(path) as file:
        file.visititems(note)
    near = [at for at in range(len(content)) if any(content[max(at - 4, 0) : at + 5])]  # others lie in no object
    return content, [at for at in near if at not in chunks]


def _restructured(draw: random.Random, content: bytes) -> bytes:
    """Return a run with one to three objects deleted, replaced, reshaped, linked or filled with awkward values."""
    stream = io.BytesIO(content)
    with h5py.File(stream, "r+") as file, np.errstate(all="ignore"):
        for _ in range(draw.choice((1, 1, 2, 3))):
            names: list[str] = []
            file.visit(names.append)
            if not names:
                break
            name = draw.choice(names)
            item, kind = file[name], draw.randrange(9)
            if kind == 0:
                del file[name]
            elif kind == 1:
                file.move(name, f"entry/{draw.choice(string.ascii_letters)}")
            elif kind == 2:
                item.attrs[draw.choice(list(item.attrs) or ["units"])] = draw.choice(
                    (*AWKWARD, "", "\ud800".encode("utf8", "replace"))
                )
            elif kind == 3:
                file[f"{name}_again" if isinstance(item, h5py.Dataset) else f"{name}/loop"] = h5py.SoftLink("/entry")
            elif isinstance(item, h5py.Dataset):
                _replace(draw, file, name, item)
    return stream.getvalue()


def _replace(draw: random.Random, file: h5py.File, name: str, item: h5py.Dataset) -> None:
    numbers = item.dtype.kind in "iuf"
    kind = draw.randrange(6)
    shape = item.shape
    if kind == 0 and numbers and item.size and shape:
        values = item[()].astype(np.float64)
        values[draw.randrange(shape[0]) :: draw.choice((1, 3, 1000))] = draw.choice(AWKWARD)
        made: Any = values
    elif kind == 1 and numbers and shape:
        made = item[()].astype(np.float64) * draw.choice((1e300, 1e-310, 1e9, -1, 0, 1e-9))
    elif kind == 2:
        made = draw.choice(("", "text", b"\xff\xfe", "2024", "x" * 70_000, ["a", "b"], []))
        made = made if not isinstance(made, list) else np.array(made, h5py.string_dtype())
    elif kind == 3:
        shape = draw.choice(((), (0,), (1,), (2, 300), (3000,)))
        with np.errstate(over="ignore"):
            made = np.full(shape, draw.choice(AWKWARD), draw.choice(("f8", "f4", "f2")))
    elif kind == 4:
        made = np.zeros(shape or (), draw.choice(("i1", "u8", "i8", "?", "c16", "S3", "V4", ">f8", "f8")))
    else:
        made = draw.choice(AWKWARD)
    units = item.attrs.get("units")
    del file[name]
    file[name] = made
    if units is not None:
        file[name].attrs["units"] = units
