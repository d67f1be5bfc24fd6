"""The same record has the same answer on every processor, and whatever its last bits are."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.protocols.request import RecordRequest
from daq.recorder import ports
from daq.recorder.record import record
from daq.runfile.rig import Rig
from stickslip.units import Measured

from . import strangers

KERNELS = {  # of OpenBLAS, and what a processor must have for them
    "Prescott": {"pni"},
    "Sandybridge": {"avx"},
    "Haswell": {"avx2", "fma"},
    "SkylakeX": {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"},
}
LAST_BITS = 1e-14
JUDGE = """
import json, sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from stickslip.errors import EXIT_DONE, EXIT_UNDECIDED, DataError
from daq.runfile import store
from fitting import rank
from processing.smoothing import smooth

rng, last_bits, found = np.random.default_rng(3), float(sys.argv[1]), {}
for path in map(Path, sys.argv[2:]):
    motion = smooth(store.load(path))
    if last_bits:
        noisy = {
            name: getattr(motion, name) * (1 + last_bits * rng.standard_normal(motion.time.size))
            for name in ("position", "velocity", "acceleration")
        }
        measured = motion.recording.position * (1 + last_bits * rng.standard_normal(motion.time.size))
        motion = replace(motion, **noisy, recording=replace(motion.recording, position=measured))
    try:
        ranking = rank(motion, laws=(3, 4, 5, 6))
    except DataError as error:
        found[path.stem] = {"code": error.exit_code, "set": [], "verdict": error.what, "laws": {}, "rms": None}
        continue
    members = ranking.laws_in_set
    found[path.stem] = {
        "code": EXIT_DONE if len(members) == 1 else EXIT_UNDECIDED,
        "set": list(members),
        "verdict": ranking.verdict.split(":")[0],
        "rms": ranking.best.rms_m,
        "laws": {
            str(law): {name: (item.value, item.stderr) for name, item in ranking.row(law).parameters.items()}
            for law in members
        },
    }
print(json.dumps(found))
"""


def available():
    """Return the kernels that this processor can run."""
    listing = Path("/proc/cpuinfo")
    flags = set(listing.read_text().partition("flags")[2].partition("\n")[0].split()) if listing.exists() else set()
    return [name for name, needs in KERNELS.items() if needs <= flags]


@pytest.fixture(scope="module")
def runs(tmp_path_factory, belt_rig):
    """Write runs that changed their set or a parameter with the processor, and two that are no stick-slip."""
    folder = tmp_path_factory.mktemp("processors")
    paths = []
    scenes = {
        "scatter-and-kicks": (
            "friction.law=3", "seed=4", "scatter.Fs=0.0979", "wear.rate=0.00251", "joint.kick=-0.0106",
            "jitter.rms=2.64e-05", "damper.c=0.01329", "encoder.circumference=0.8192",
        ),
        "harsh": (
            "friction.law=5", "seed=3", "scatter.Fs=0.12", "wear.rate=0.00833", "joint.kick=0.0164",
            "jitter.rms=2e-4", "damper.c=0.0102", "belt.ripple=0.02", "belt.ripple_hz=2.613",
        ),
        "nominal": ("friction.law=6", "seed=9", "scatter.Fs=0.0413", "wear.rate=0.00463", "joint.kick=-0.0136"),
    }  # fmt: skip
    for name, changes in scenes.items():
        paths.append(folder / f"{name}.h5")
        record(RecordRequest(ports.rig_url("rig", list(changes), False), paths[-1], 1000, 30.0))
    blank = belt_rig.recording(law=5, duration=1.0)
    known = Rig(mass=Measured(0.3, 1e-3), datum=Measured(0.0, 5e-4), belt_speed=Measured(0.22, 2e-3))
    for name, seed, rig in (("sine", 12, known), ("sawtooth", 1, Rig(mass=Measured(0.3)))):
        time, position = getattr(strangers, name)(np.random.default_rng(seed))
        stranger = replace(blank, time=time, position=position, segment=np.zeros(time.size, np.uint16), rig=rig)
        paths.append(belt_rig.written(folder / f"{name}.h5", stranger))
    return paths


def judged(runs, kernel=None, last_bits=0.0):
    """Judge the runs in a process of their own, with one kernel of the linear algebra."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"} | ({"OPENBLAS_CORETYPE": kernel} if kernel else {})
    line = [sys.executable, "-c", JUDGE, str(last_bits), *map(str, runs)]
    done = subprocess.run(line, capture_output=True, text=True, env=environment, check=True)
    return json.loads(done.stdout)


KERNEL, OTHERS = (available()[-1], available()[:-1]) if available() else (None, [])  # the newest, which OpenBLAS takes
# `make test-kernels` names one kernel after the other, `make test-slow` none: it takes the one that is most unlike.
NAMED = os.environ.get("STICKSLIP_BLAS_KERNEL")


@pytest.fixture(scope="module")
def native(runs):
    """Judge the runs as they are."""
    return judged(runs, KERNEL)


def assert_the_same(found, native):
    for name, expected in native.items():
        got = found[name]
        assert (got["code"], got["set"], got["verdict"]) == (expected["code"], expected["set"], expected["verdict"])
        for law, parameters in expected["laws"].items():
            for parameter, (value, stderr) in parameters.items():
                off = abs(got["laws"][law][parameter][0] - value)
                assert off <= 0.1 * stderr, f"{name}, law {law}, {parameter}: off by {off / stderr:.2g} standard errors"


@pytest.mark.slow
def test_the_laws_are_named(native):
    assert {name: row["set"] for name, row in native.items()} == {
        "scatter-and-kicks": [3],
        "harsh": [5],
        "nominal": [6],
        "sine": [],
        "sawtooth": [],
    }


@pytest.mark.parametrize(
    "kernel",
    [NAMED] if NAMED in OTHERS else [pytest.param(kernel, marks=pytest.mark.slow) for kernel in OTHERS[:1] or [KERNEL]],
)
def test_neither_the_kernel_of_the_linear_algebra_nor_the_last_bits_decide_anything(runs, native, kernel):
    """Both are changed at once: each alone is a smaller change, and a judgement costs half a minute."""
    found = judged(runs, kernel, LAST_BITS)
    assert_the_same(found, native)
    # Two of 26 such changes of `harsh` used to end in a poorer minimum, five and six times as far from the record.
    assert found["harsh"]["rms"] == pytest.approx(native["harsh"]["rms"], rel=1e-3)
