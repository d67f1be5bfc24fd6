"""Scenes: what is named exists, and a change changes that alone."""

from pathlib import Path

import pytest

from rig_sim.friction.contact import force
from rig_sim.friction.law import LAWS
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import parse_changes, scene


def changed(*settings: str, base: str = "base") -> Scene:
    return scene(base, **parse_changes(settings))


def test_a_slope_of_the_ramp_is_that_slope_whatever_the_break_away_level() -> None:
    """With static 1.3 a ramp given by its slope used to be 1.3 times as steep."""
    friction = changed("friction.law=6", "friction.G_stick=-5", "friction.static=1.3").friction
    assert friction is not None
    p = friction.parameters()
    assert p["d"] == pytest.approx(1.3 / 5)
    assert force(LAWS[6], -0.1, **p, static=friction.static) == pytest.approx(0.5)
    assert force(LAWS[6], -p["d"], **p, static=friction.static) == pytest.approx(1.3)


@pytest.mark.parametrize("name", ["base", "damped", "forced", "rig"])
@pytest.mark.parametrize("law", range(1, 7))
def test_every_builtin_scene_carries_what_every_law_needs(name: str, law: int) -> None:
    flow = changed(f"friction.law={law}", base=name).flow()
    assert flow.ramp == (law in (2, 4, 6))
    assert flow.curve == (law - 1) // 2
    assert (flow.d > 0) == (law in (2, 4, 6))
    assert (flow.G_slip > 0) == (law in (3, 4))
    assert (flow.gamma > 0) == (law in (5, 6))


def test_ramp_width_and_slope_are_one_parameter() -> None:
    assert changed("friction.law=6").flow().d == 0.2
    by_width = changed("friction.law=6", "friction.d=0.1")
    assert by_width.friction is not None
    assert by_width.friction.G_stick is None
    assert by_width.flow().d == 0.1
    by_slope = changed("friction.law=6", "friction.G_stick=-5e6", base="rig")
    assert by_slope.friction is not None
    assert by_slope.friction.d is None
    assert by_slope.flow().d == by_slope.flow().Fs / 5e6


def test_an_absent_section_is_created_and_only_named_terms_exist() -> None:
    assert scene("base").terms() == ["mass", "spring", "belt", "friction", "start"]
    assert scene("base").flow().u0 == 0
    driven = changed("drive.u0=0.2", "drive.omega=0.3")
    assert "drive" in driven.terms()
    assert (driven.flow().u0, driven.flow().omega) == (0.2, 0.3)


def test_changes_from_python_may_be_nested_or_dotted() -> None:
    nested = scene("rig", friction={"law": 3, "Fs": 2}, seed=7)
    dotted = scene("rig", **{"friction.law": 3, "friction.Fs": 2, "seed": 7})
    assert nested == dotted
    assert nested.seed == 7
    assert nested.flow().Fs == 2.0


def test_the_older_name_of_a_section_is_still_read(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text("[mass]\nm = 1.0\n[spring]\nk = 1.0\n[tell]\ntruth = true\n")
    for found in (scene(path), scene("base", **{"tell.truth": True}), scene("base", tell={"truth": True})):
        assert found.output is not None
        assert found.output.truth
