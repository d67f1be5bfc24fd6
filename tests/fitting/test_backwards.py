"""A belt that runs towards -x: the same set and the same parameters, with the signs of what points along x turned."""

import json
import math

import pytest

from daq.cli import app as daq_cli
from daq.runfile import store
from fitting import cli, rank
from processing.smoothing import smooth
from stickslip.console import application

pytestmark = pytest.mark.usefixtures("undrawn_reports", "asked_laws_alone")
DATUM_SD = 5e-4  # m, of the simulated board
TURNED = ("v_dr",)  # the spring rests where it rests, whichever way the belt runs


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Record the simulated rig with the belt running either way."""
    folder = tmp_path_factory.mktemp("backwards")

    def of(law, speed):
        path = folder / f"{law}-{speed}.h5"
        if path.exists():
            return path
        line = ["record", "--scene", "rig", "--duration", "8", "-o", str(path), "--json"]
        for change in (f"friction.law={law}", "seed=1", f"belt.speed={speed}"):
            line += ["--set", change]
        assert application.run(daq_cli.app, line) == 0
        return path

    return of


@pytest.mark.parametrize("law", [2, *(pytest.param(law, marks=pytest.mark.slow) for law in (3, 6))])
def test_a_backward_belt_gives_the_same_law(recorded, law):
    laws = (1, 2) if law == 2 else (3, 4, 5, 6)
    forward, backward = (rank(smooth(store.load(recorded(law, speed))), laws=laws) for speed in (0.22, -0.22))
    # Counts and jitter fall otherwise on the mirrored motion: the same curve with the other contact may be in one set.
    partner = law + 1 if law % 2 else law - 1
    assert set(backward.laws_in_set) ^ set(forward.laws_in_set) <= {partner}
    assert backward.laws_in_set[0] == forward.laws_in_set[0]
    assert law in forward.laws_in_set
    assert law in backward.laws_in_set
    for name, item in forward.best.parameters.items():
        mirrored = backward.best.parameters[name]
        sign = -1.0 if name in TURNED else 1.0
        # Counts and jitter fall otherwise on the mirrored motion: the same within the fit's own error, and what the
        # calibration alone knows (constant friction shows x0 + Fs/k) within the calibration's.
        calibrated = DATUM_SD if name in ("x0", "Fs/k") and law in (1, 2) else 0.0
        error = max(math.hypot(item.stderr, mirrored.stderr), calibrated, 1e-9)
        assert abs(sign * mirrored.value - item.value) <= 4 * error, name
    assert backward.best.rms_m == pytest.approx(forward.best.rms_m, rel=0.3)


def test_the_command_tells_a_backward_belt_by_its_sign(recorded, capsys):
    path = recorded(5, -0.22)
    capsys.readouterr()
    assert application.run(cli.app, [str(path), "--laws", "3,5", "--no-report", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["set"] == [5]
    assert document["ranking"][0]["parameters"]["v_dr"]["value"] == pytest.approx(-0.22, rel=2e-3)
