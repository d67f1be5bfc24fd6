"""Rankings of synthetic runs, made once and shared by the tests of the fit."""

import importlib.util
import sys
from functools import cache
from pathlib import Path

import pytest

from fitting.ranking import rank
from processing.smoothing import smooth


def _beside(name):
    """Load a generator beside this file by its path: tests have no packages."""
    spec = importlib.util.spec_from_file_location(f"fitting_{name}", Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


synthetic_rig = _beside("synthetic")
stranger_records = _beside("strangers")


@pytest.fixture(scope="session")
def strangers():
    """Give the module of records that are no stick-slip."""
    return stranger_records


@pytest.fixture(scope="session")
def synthetic():
    """Give the generator's module."""
    return synthetic_rig


@pytest.fixture(scope="session")
def ranked():
    """Give a function that ranks a synthetic run and remembers it: ``ranked(law=5, seed=1, ...)``."""

    @cache
    def of(**changes):
        return rank(smooth(synthetic_rig.recording(**changes)))

    return of


@pytest.fixture(scope="session")
def motion_of(synthetic):
    """Give a function that smooths a synthetic run and brings it into the fit's frame."""
    from fitting import motion

    @cache
    def of(**changes):
        recording = synthetic.recording(**changes)
        return motion.of(smooth(recording), recording.rig, None)

    return of
