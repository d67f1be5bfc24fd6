"""The suffix of an output is that of its format, in every command that writes one."""

from pathlib import Path

import pytest

from stickslip.output import suffix


@pytest.mark.parametrize("name", ["run.h5", "run.H5", "run", "run.nxs", "run.2024-05-01", "run.v2"])
def test_a_name_that_promises_nothing_else_is_accepted(name):
    suffix.check_run(Path(name))
