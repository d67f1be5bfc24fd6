"""Every key of a scene is described on its page of the reference; those of rig.toml: tests/daq/test_python.py."""

import re
from typing import get_args

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


def test_every_key_of_a_scene_is_described():
    text = (REFERENCE / "scenes.md").read_text() + (REFERENCE / "dynamics.md").read_text()
    keys = scene_keys()
    assert {"friction.gamma", "seed", "start.x"} <= set(keys)
    assert {part for key in keys for part in key.split(".") if not re.search(rf"\b{part}\b", text)} == set()
