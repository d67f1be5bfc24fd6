"""A disk that is full: the file's name, exit code 3, nothing half-written, no crash, in whatever is written."""

import importlib
import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.cli.app import app
from stickslip.console import application as terminal
from stickslip.errors import InputError
from stickslip.output import atomic, disk
from stickslip.output import lock as lock_module

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits of file size are POSIX")

HANGS_S = 120
SAMPLE = Path(__file__).parents[3] / "data_samples" / "law5.h5"


@pytest.fixture
def full(monkeypatch):
    """Return a context in which no file grows beyond so many bytes: to a writer, a full disk.

    It ends with the block, not with the test: what pytest itself prints may go to a file.  No bytecode is kept: Python
    3.11 kept what fitted of a module that was first imported in the block, and later commands ended with "marshal data
    too short".
    """
    import resource

    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    @contextmanager
    def limited(size):
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
            signal.signal(signal.SIGXFSZ, handler)

    return limited


def refused(capsys, application, *arguments):
    code = terminal.run(application, [str(argument) for argument in arguments])
    return code, capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("module", "line", "room"),
    [
        ("rig_sim.cli.app", "run rig --until 20 --rate 1000 -o motion.h5", 20_000),
        ("rig_sim.cli.app", "run rig --until 20 --rate 1000 -o motion.csv", 20_000),
        ("processing.cli", "inspect run.h5 --plot out.png", 5000),
        ("daq.cli.app", "export run.h5 --csv out.csv", 5000),
    ],
)
def test_what_does_not_fit_is_named_and_leaves_everything_as_it_was(
    full, tmp_path, capsys, monkeypatch, module, line, room
):
    monkeypatch.chdir(tmp_path)
    run = Path(shutil.copy(SAMPLE, "run.h5"))
    application = importlib.import_module(module).app
    with full(room):
        code, said = refused(capsys, application, *line.split())
        assert code == 3
        output = line.split()[-1]
        assert f": {output}: the disk is full; " in said
        assert list(tmp_path.iterdir()) == [tmp_path / "run.h5"]
    assert run.read_bytes() == SAMPLE.read_bytes()


def test_firmware_on_a_full_disk_is_a_disks_failure_and_leaves_no_empty_file(full, tmp_path, capsys):
    with full(1000):
        code, line = refused(capsys, app, "firmware", "--board", "uno", "-o", tmp_path / "fw")
        assert code == 3
        assert ": the disk is full; " in line
        assert all(path.stat().st_size > 0 for path in (tmp_path / "fw").iterdir())


def twice(x):
    return 2.0 * x


@pytest.mark.parametrize("number", [0, 1, 2, -1])
def test_ctrl_c_while_hdf5_writes_comes_when_the_file_is_closed(tmp_path, monkeypatch, number):
    # Within HDF5's own write a KeyboardInterrupt is lost with a part of the file, or ends the process.
    path, values = tmp_path / "run.h5", np.arange(20_000.0)
    interrupts = 0
    writes = []

    def write(sink, data, then=disk.Sink.write):
        nonlocal interrupts
        writes.append(len(data))
        if len(writes) - 1 == at:
            interrupts += 1
            signal.raise_signal(signal.SIGINT)
        return then(sink, data)

    def make():
        with disk.open_hdf5(path, "w") as file:
            file.create_dataset("values", data=values, chunks=(1000,), compression="gzip")

    monkeypatch.setattr(disk.Sink, "write", write)
    at = None
    make()
    at = number % len(writes)
    writes.clear()
    with pytest.raises(KeyboardInterrupt):
        make()
    assert interrupts == 1
    with h5py.File(path) as file:
        assert np.array_equal(file["values"][()], values)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_machine_code_that_does_not_fit_costs_no_result(full, tmp_path, capsys):
    from stickslip.compute.compile import build

    quick = build(twice, tmp_path)
    with full(100):
        assert quick(21.0) == 42.0
        assert f"compiled code cannot be stored: {tmp_path}: File too large" in capsys.readouterr().err


def test_a_symbolic_link_stays_and_the_file_behind_it_is_replaced(tmp_path):
    real, link = tmp_path / "real.txt", tmp_path / "link.txt"
    real.write_text("old")
    link.symlink_to(real)
    with atomic.replacing(link, force=True) as temporary:  # the link itself was replaced
        temporary.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_what_a_killed_command_left_is_removed_by_the_next(tmp_path):
    # It stayed for ten minutes, whoever came.
    target = tmp_path / "run[1].h5"
    left, longer, other = (tmp_path / f".{name}.abc.partial" for name in ("run[1].h5", "run[1].h5.x", "run1.h5"))
    for path in (tmp_path / ".run[1].h5.partial", left, longer, other):
        path.write_text("half")
    with atomic.replacing(target, force=True) as temporary:
        temporary.write_text("whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([target.name, longer.name, other.name])


def test_a_lock_on_the_folder_holds_nobody_up(tmp_path):
    # `flock DIR command` is how people keep two scripts apart.
    import fcntl

    folder = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    line = [sys.executable, "-m", "daq.cli.app", "record", "--duration", "0.1", "-o", str(tmp_path / "run.h5")]
    try:
        done = subprocess.run(line, capture_output=True, text=True, timeout=HANGS_S, check=False)
    finally:
        os.close(folder)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "run.h5"]


@pytest.mark.parametrize("kind", ["link", "folder", "another user's"])
def test_a_name_that_is_taken_by_something_else_is_left_alone(tmp_path, kind, monkeypatch):
    # In a folder that others may write to, who put a link there must not have its target written or removed.
    taken, theirs = tmp_path / ".run.h5.partial", tmp_path / "theirs"
    theirs.write_text("theirs")
    if kind == "link":
        taken.symlink_to(theirs)
    elif kind == "folder":
        taken.mkdir()
    else:
        taken.write_text("half")
        opened = os.open

        def refuse(path, *how, **more):
            if Path(path) == taken and not how[0] & os.O_CREAT:
                raise PermissionError(13, "Permission denied", str(path))
            return opened(path, *how, **more)

        monkeypatch.setattr(os, "open", refuse)
    with atomic.replacing(tmp_path / "run.h5", force=False) as temporary:
        temporary.write_text("whole")
    assert (tmp_path / "run.h5").read_text() == "whole"
    assert theirs.read_text() == "theirs"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".run.h5.partial", "run.h5", "theirs"]


def test_a_file_that_loses_its_name_before_it_is_locked_is_not_taken_for_the_one_that_has_it(tmp_path, monkeypatch):
    # Between creation and lock another command may take a new file for one that was left, and remove it.
    path = tmp_path / "new"
    lock = lock_module._lock

    def slow(fd):
        monkeypatch.setattr(lock_module, "_lock", lock)
        path.unlink()
        path.write_text("another command's")
        lock(fd)

    monkeypatch.setattr(lock_module, "_lock", slow)
    with pytest.raises(BlockingIOError):
        lock_module.FileLock(path, new=True)
    assert path.read_text() == "another command's"


def test_a_command_that_goes_on_writing_is_named_instead_of_waited_for_without_end(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic, "WAIT_S", 0.1)
    target = tmp_path / "run.h5"
    with (
        atomic.replacing(target, force=True) as temporary,
        pytest.raises(InputError, match="another command is writing this file"),
        atomic.replacing(target, force=True),
    ):
        pass
    assert temporary.exists() is False
    assert target.exists()
