"""The suffix of an output is that of its format, in every command that writes one."""

from pathlib import Path

import pytest

from stickslip.errors import InputError
from stickslip.output import suffix


@pytest.mark.parametrize("name", ["run.h5", "run.H5", "run", "run.nxs", "run.2024-05-01", "run.v2"])
def test_a_name_that_promises_nothing_else_is_accepted(name):
    suffix.check_run(Path(name))


@pytest.mark.parametrize(
    ("form", "name"),
    [(suffix.PAGE, "report.pdf"), (suffix.CSV, "table.h5"), (suffix.TOML, "rig.h5"), (suffix.CSV, "table.tsv")],
)
def test_every_format_refuses_the_suffixes_of_others(form, name):
    with pytest.raises(InputError, match="is the suffix of"):
        suffix.check(Path(name), form)
