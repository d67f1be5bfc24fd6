"""`fit-friction` called with its flags as keywords, whatever group each belongs to."""

from dataclasses import fields

from fitting import cli, flags

GROUPS = {
    "laws": flags.LawFlags,
    "rig": flags.CalibrationFlags,
    "part": flags.PartFlags,
    "outputs": flags.OutputFlags,
    "work": flags.WorkFlags,
}


def fit(*files, **given):
    """Return the command's answer."""
    groups = {
        name: group(**{own.name: given.pop(own.name) for own in fields(group) if own.name in given})
        for name, group in GROUPS.items()
    }
    assert not given, f"no flags: {', '.join(given)}"
    return cli.fit(*files, **groups)
