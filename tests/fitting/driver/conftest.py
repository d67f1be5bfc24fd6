"""Records of the tests' own rig, cut into cycles."""

from functools import cache

import pytest

from fitting.judge.law_fits import cut_run


@pytest.fixture(scope="session")
def runs_of(motion_of):
    """Give a function that returns the run of a synthetic scene, ready for the driver; remembered by its changes."""

    @cache
    def of(**changes):
        return [cut_run(motion_of(**changes), frozenset())]

    return of
