"""Processes that share the work of a command."""

import signal
import sys

import pytest

from daq.compute.workers import workers


def blocked(_: int) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.skipif(sys.platform == "win32", reason="signal masks are POSIX")
def test_a_process_that_is_started_gets_no_interrupt() -> None:
    # Ctrl-C while processes started used to print the tracebacks of their imports.
    with workers(2) as each:
        assert list(each(blocked, [0, 1])) == [True, True]
    assert not blocked(0)
