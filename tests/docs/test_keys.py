"""Every key of a scene and of rig.toml is described on its page of the reference."""

import re
from dataclasses import fields
from typing import get_args

import pytest

from daq.runfile.rig import Rig
from rig_sim.scenes.scene import Scene

from . import examples

REFERENCE = examples.ROOT / "docs" / "reference"


def scene_keys() -> list[str]:
    """Return the keys of a scene, those of its sections as ``section.key``."""
    found = []
    for name, field in Scene.model_fields.items():
        sections = [kind for kind in (field.annotation, *get_args(field.annotation)) if hasattr(kind, "model_fields")]
        found += [f"{name}.{key}" for kind in sections for key in kind.model_fields] or [name]
    return found


def test_the_keys_were_read():
    assert {"friction.gamma", "seed", "start.x"} <= set(scene_keys())


@pytest.mark.parametrize("key", scene_keys())
def test_every_key_of_a_scene_is_described(key):
    text = (REFERENCE / "scenes.md").read_text() + (REFERENCE / "dynamics.md").read_text()
    for part in key.split("."):
        assert re.search(rf"\b{part}\b", text), part


@pytest.mark.parametrize("key", [field.name for field in fields(Rig)])
def test_every_key_of_rig_toml_is_described(key):
    assert re.search(rf"`{key}`", (REFERENCE / "rig-toml.md").read_text())
