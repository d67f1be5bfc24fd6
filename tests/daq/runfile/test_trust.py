"""A run file from somebody else reads nothing but itself, no more than it can hold, and crashes no program."""

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from daq.runfile import isolation, listing, store, trust
from stickslip.errors import InputError

from .runs import imported_run

POSITION = "instrument/encoder/value_log/value"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    store.write(tmp_path / "run.h5", imported_run(50))
    return tmp_path / "run.h5"


def external_link(entry: h5py.Group, secret: Path) -> None:
    del entry[POSITION]
    entry[POSITION] = h5py.ExternalLink(str(secret), "/secret")


def external_group(entry: h5py.Group, secret: Path) -> None:
    entry["tags"] = h5py.ExternalLink(str(secret), "/")


def external_storage(entry: h5py.Group, secret: Path) -> None:
    del entry[POSITION]
    entry.create_dataset(POSITION, (50,), "f8", external=[(str(secret), 0, 400)])


def virtual(entry: h5py.Group, secret: Path) -> None:
    del entry[POSITION]
    layout = h5py.VirtualLayout((50,), "f8")
    layout[:] = h5py.VirtualSource(str(secret), "secret", (50,))
    entry.create_virtual_dataset(POSITION, layout)


def huge(entry: h5py.Group, secret: Path) -> None:
    del entry[POSITION]
    entry.create_dataset(POSITION, (1 << 40,), "f8", chunks=(1 << 10,), compression="gzip")


def many(entry: h5py.Group, secret: Path) -> None:
    for number in range(100):
        entry.create_dataset(f"x{number}", (1_000_000,), "f8", chunks=(1 << 10,), compression="gzip")


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        # Each of these was read as if it were the run's own: /etc/passwd as positions, or a MemoryError.
        (external_link, "is a link to another file"),
        (external_group, "is a link to another file"),
        (external_storage, "reads its data from another file"),
        (virtual, "reads its data from another file"),
        (huge, "declares 8796093022208 bytes"),
        (many, "declares 8000000 bytes"),
    ],
)
def test_what_leads_out_of_the_file_is_refused(
    run: Path, tmp_path: Path, spoil: Callable[[h5py.Group, Path], None], what: str
) -> None:
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["secret"] = np.arange(50.0)
    with h5py.File(run, "r+") as file:
        spoil(file["entry"], secret)
    before = run.read_bytes()
    with pytest.raises(InputError, match=what):
        store.load(run)
    with pytest.raises(InputError, match=what):
        store.annotate(run, {"title": "x"})
    assert run.read_bytes() == before


@pytest.mark.parametrize("start", ["_fork", "_spawn"])
def test_a_file_that_crashes_the_hdf5_library_is_refused(
    run: Path, monkeypatch: pytest.MonkeyPatch, start: str
) -> None:
    # Every command ended with a segmentation fault.
    monkeypatch.setattr(isolation, "_fork", getattr(isolation, start))
    text, nothing = bytes.fromhex("19 01 01 00 10 00 00 00"), bytes.fromhex("19 3e 01 00 10 00 00 00")
    before = run.read_bytes()
    assert text in before
    run.write_bytes(before.replace(text, nothing))
    with pytest.raises(InputError, match="it crashes the library"):
        store.load(run)
    with pytest.raises(InputError, match="it crashes the library"):
        store.extend(run, "smooth", lambda entry: None)


@pytest.mark.parametrize("stored", [zlib.compress(bytes(8)), zlib.compress(bytes(1 << 26)), zlib.compress(b"")])
def test_a_chunk_of_the_wrong_length_is_refused(run: Path, stored: bytes) -> None:
    # HDF5 filled up a short one with whatever lay in memory, and unpacked all of a long one.
    with h5py.File(run, "r+") as file:
        entry = file["entry"]
        del entry[POSITION]
        made = entry.create_dataset(POSITION, (50,), "f8", chunks=(50,), compression="gzip")
        made.id.write_direct_chunk((0,), stored)
    with pytest.raises(InputError, match="bytes instead of 400"):
        store.load(run)


def test_a_damaged_stage_is_reported_and_the_run_is_still_read(run: Path) -> None:
    # A damaged checksum in a stage was a traceback of `daq.load`'s callers.
    def smooth(entry: h5py.Group) -> None:
        made = entry.create_group("smooth")
        made["parameters/sha256_input"] = "x"
        made.create_dataset("kinematics/time", data=np.zeros(1000), chunks=(1000,), fletcher32=True)

    store.extend(run, "smooth", smooth)
    with h5py.File(run) as file:
        place = file["entry/smooth/kinematics/time"].id.get_chunk_info(0).byte_offset
    content = bytearray(run.read_bytes())
    content[place + 100] ^= 1
    run.write_bytes(content)
    assert store.load(run).time.size == 50


@pytest.mark.parametrize("error", [ValueError, ZeroDivisionError])
def test_damage_without_words_is_listed(run: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception]) -> None:
    # An error of the library without a message, and a sample rate of 0, were a traceback of 'daq list'.
    def damaged(*_: Any) -> None:
        raise error

    monkeypatch.setattr(listing, "_make_row", damaged)
    assert [row.problem for row in listing.list_runs([run.parent])] == [f"is damaged: {error.__name__}"]


def test_links_within_the_file_hang_nothing(run: Path) -> None:
    with h5py.File(run, "r+") as file:
        file["entry/tags"] = h5py.SoftLink("/entry")
        file["entry/raw/again"] = h5py.SoftLink("/entry/raw/again")
    with pytest.raises(InputError):  # tags that are no texts
        store.load(run)


def test_a_child_reads_each_state_of_a_file_once_and_none_that_this_process_wrote(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    works: list[str] = []

    def counted(work: Callable[[Path], bytes], *arguments: Any) -> bytes:
        works.append(work.__name__)
        return isolation.run_isolated(work, *arguments)

    monkeypatch.setattr(trust, "run_isolated", counted)
    store.load(run)
    assert works == []
    run.write_bytes(run.read_bytes())
    for _ in range(3):
        store.load(run)
    store.annotate(run, {"title": "x"})
    store.load(run)
    assert works == ["_visit", "_change_notes"]
