"""A run file from somebody else reads nothing but itself, and no more than it can hold."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.errors import InputError
from daq.runfile import store
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig

POSITION = "instrument/encoder/value_log/value"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return a run file of 50 samples."""
    times = [f"2024-05-01T12:00:0{second}+02:00" for second in (0, 1)]
    time = np.arange(50) / 100
    file = tmp_path / "run.h5"
    store.write(file, Recording("a track", *times, rate_hz=100.0, rig=Rig(), time=time, position=np.sin(time)))
    return file


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


def loop(entry: h5py.Group, secret: Path) -> None:
    entry["tags"] = h5py.SoftLink("/entry")
    entry["raw/again"] = h5py.SoftLink("/entry/raw/again")


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        # Each of these was read as if it were the run's own: /etc/passwd as positions, or a MemoryError.
        (external_link, "is a link to another file"),
        (external_group, "is a link to another file"),
        (external_storage, "reads its data from another file"),
        (virtual, "reads its data from another file"),
        (huge, "declares 8796093022208 bytes"),
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


def test_links_within_the_file_hang_nothing(run: Path) -> None:
    with h5py.File(run, "r+") as file:
        loop(file["entry"], run)
    with pytest.raises(InputError):  # tags that are no texts
        store.load(run)


def test_an_own_run_and_its_stages_pass(run: Path) -> None:
    def smooth(entry: h5py.Group) -> None:
        entry.create_group("smooth")["x"] = np.zeros(200_000)

    store.extend(run, "smooth", smooth)
    assert store.load(run).time.size == 50
