"""Processes that share the work of a command."""

import os
import signal
import sys
import time

import pytest

from stickslip.compute.workers import workers
from stickslip.errors import DeviceError


def blocked(_):
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.skipif(sys.platform == "win32", reason="signal masks are POSIX")
def test_a_process_that_is_started_gets_no_interrupt():
    with workers(2) as each:
        assert list(each(blocked, [0, 1])) == [True, True]
    assert not blocked(0)


def square_and_process(number):
    time.sleep(0.05)
    if number == 13:
        raise ZeroDivisionError(number)
    return number**2, os.getpid()


def test_a_joining_process_works_too_and_keeps_the_order():
    with workers(2, join=True) as each:
        found = list(each(square_and_process, range(14, 94)))
    assert [square for square, _ in found] == [number**2 for number in range(14, 94)]
    processes = {process for _, process in found}
    assert os.getpid() in processes
    assert len(processes) == 2


def test_the_error_of_an_item_comes_at_its_turn():
    found = []
    with pytest.raises(ZeroDivisionError), workers(2, join=True) as each:
        found.extend(square for square, _ in each(square_and_process, range(40)))
    assert found == [number**2 for number in range(13)]


def killed_elsewhere(parent):
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return parent


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")
@pytest.mark.parametrize("join", [False, True])
def test_a_killed_process_is_one_clear_error(join: bool) -> None:
    with pytest.raises(DeviceError, match="was killed"), workers(2, join=join) as each:
        list(each(killed_elsewhere, [os.getpid()] * 1000))
