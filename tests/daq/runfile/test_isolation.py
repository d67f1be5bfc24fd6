"""A child process answers, refuses or breaks off; this process survives each."""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from daq.runfile.isolation import BrokenOffError, run_isolated
from stickslip.errors import InputError

MB = 1 << 20


def answers(path: Path) -> bytes:
    return str(path).encode() * 100_000


def refuses(path: Path) -> bytes:
    raise InputError("is wrong", str(path), "mend it")


def crashes(path: Path) -> bytes:
    os.kill(os.getpid(), signal.SIGSEGV)
    return b"="


def takes_memory(path: Path) -> bytes:
    return np.ones(100 * MB).tobytes()


def takes_cpu(path: Path) -> bytes:
    while True:
        pass


def takes_time(path: Path) -> bytes:
    time.sleep(60)
    return b""


def has_a_fault(path: Path) -> bytes:
    raise ZeroDivisionError


@pytest.mark.parametrize(
    ("work", "what"),
    [
        (crashes, "crashes the library"),
        (takes_memory, "more than 100 MB"),
        (takes_cpu, "more than 0 s"),
        (takes_time, "more than 0 s"),
    ],
)
def test_what_breaks_off_ends_the_child_alone(work, what):
    with pytest.raises(BrokenOffError, match=what):
        run_isolated(work, Path("a"), 0.05, 100 * MB)


def test_a_fault_of_ours_is_no_fault_of_the_file():
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        run_isolated(has_a_fault, Path("a"), 5, 100 * MB)


def test_no_child_and_no_descriptor_stays_behind(monkeypatch):
    # Only these children are looked for: other tests of this process have left theirs, as multiprocessing's tracker.
    children, fork = [], os.fork
    monkeypatch.setattr(os, "fork", lambda: children.append(fork()) or children[-1])
    before = os.listdir("/proc/self/fd") if Path("/proc/self/fd").is_dir() else []
    for _ in range(20):
        run_isolated(answers, Path("a"), 5, 100 * MB)
    assert not before or os.listdir("/proc/self/fd") == before
    assert sys.platform != "linux" or len(children) == 20
    for child in children:
        with pytest.raises(ChildProcessError):
            os.waitpid(child, os.WNOHANG)
