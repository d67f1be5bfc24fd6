"""The calibration: its TOML form, what it refuses, and in which words."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.runfile.rig import DECODERS, Rig, find_replaced
from stickslip.errors import InputError
from stickslip.units import Measured

finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=1e-300, max_value=1e300)
not_negative = st.floats(min_value=0, max_value=1e300)


def measured(values: st.SearchStrategy[float]) -> st.SearchStrategy[Measured | None]:
    return st.none() | st.builds(Measured, values, not_negative)


rigs = st.builds(
    Rig,
    name=st.text(st.characters(exclude_categories=["Cs"])),
    decoder=st.sampled_from(DECODERS),
    metres_per_count=measured(positive | positive.map(lambda x: -x)),
    counts_per_revolution=st.none() | st.integers(1, 10**9),
    belt_metres_per_count=measured(positive | positive.map(lambda x: -x)),
    counter_bits=st.sampled_from([8, 16, 24, 32]),
    mass=measured(positive),
    stiffness=measured(positive),
    datum=st.none(),
    x0=measured(finite),
    damping=measured(not_negative),
    belt_speed=measured(finite),
)


@given(rigs | rigs.map(lambda rig: replace(rig, datum=rig.x0, x0=None)))
def test_toml_reads_back_an_equal_rig(rig: Rig) -> None:
    assert Rig.from_toml(rig.to_toml(), "rig.toml") == rig


def test_absent_quantities_stay_unknown() -> None:
    rig = Rig.from_toml("[rig]\nmass = 0.3\n", "rig.toml")
    assert rig.mass == Measured(0.3, 0.0)
    assert rig.stiffness is None
    assert rig.metres_per_count is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[rig]\nmas = 1", ["rig.toml", "rig.mas", "'mass'"]),
        ("[encoder]\ndatum_ds = 1", ["encoder.datum_ds", "'datum_sd'"]),
        ("[encodr]\ndatum = 1", ["[encodr]", "'encoder'"]),
        ("[rig]\nx0 = 0.06\n[encoder]\ndatum = 0.06", ["encoder.datum and rig.x0", "datum is -x0"]),
        ("[encoder]\nx0 = 0.06", ["encoder.x0", "section [rig]"]),
        ("rig = 3", ["rig is a value", "[rig]"]),
        ("[rig]\nmass = -1", ["mass is -1", "positive"]),
        ("[rig]\nmass = inf", ["mass is inf"]),
        ("[rig]\nmass = '1 kg'", ["rig.mass", "'1 kg'", "SI"]),
        ("[rig]\nmass = true", ["rig.mass", "True"]),
        ("[rig]\nmass_sd = 1", ["mass_sd requires"]),
        ("[rig]\nmass = 1\nmass_sd = -1", ["mass_sd is -1"]),
        ("[encoder]\nmetres_per_count = 0", ["not zero"]),
        ("[encoder]\ndecoder = 'x3'", ["'x3'", "did you mean"]),
        ("[encoder]\ncounter_bits = 17", ["17", "8, 16, 24, 32"]),
        ("[encoder]\ncounts_per_revolution = 1.5", ["1.5", "whole"]),
        ("[rig]\nname = 5", ["rig.name", "quotes"]),
        ("a = " + "[" * 5000, ["nested too deeply"]),  # these two were tracebacks
        ("[rig]\nmass = " + "9" * 5000, ["too many digits"]),
        ("[rig]\nmass = " + "9" * 400, ["too many digits"]),  # an OverflowError
        ("[rig]\nmass = [0x" + "f" * 5000 + "]", ["too many digits"]),  # a ValueError in the message
        ("[rig\n", ["invalid TOML", "line 1"]),
    ],
)
def test_bad_toml_is_refused_by_name(text: str, words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        Rig.from_toml(text, "rig.toml")
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("stored", "used", "texts"),
    [
        (Rig(mass=Measured(0.3)), Rig(mass=Measured(300.0)), ["mass: 300 kg overrides the stored value, 0.3 kg"]),
        (Rig(stiffness=Measured(10.5)), Rig(stiffness=Measured(10500.0)), ["stiffness: 10500 N/m overrides"]),
        (Rig(mass=Measured(0.3, 0.001)), Rig(mass=Measured(0.31, 0.001)), ["mass: 0.31 kg"]),
        (Rig(mass=Measured(0.3, 0.02)), Rig(mass=Measured(0.31, 0.001)), []),
        (Rig(mass=Measured(0.3)), Rig(mass=Measured(0.301)), []),  # a value without an error is good to 1 %
        (Rig(), Rig(mass=Measured(300.0)), []),
        (Rig(belt_speed=Measured(0.22)), Rig(belt_speed=Measured(-0.22)), ["belt_speed: -0.22 m/s"]),
        (Rig(datum=Measured(-0.06)), Rig(x0=Measured(0.06)), []),  # a datum is -x0
        (Rig(datum=Measured(0.06)), Rig(x0=Measured(0.06)), ["x0: 0.06 m overrides the stored value, -0.06 m"]),
        (Rig(metres_per_count=Measured(1e-5)), Rig(metres_per_count=Measured(1e-2)), ["metres_per_count: 0.01 m"]),
    ],
)
def test_a_stored_value_that_another_replaces_beyond_their_errors_is_said(stored, used, texts):
    rows = find_replaced(stored, used)
    assert len(rows) == len(texts)
    assert all(text in row.text for row, text in zip(rows, texts, strict=True))
