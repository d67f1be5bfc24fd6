"""The encoder: every edge is seen, in order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.wire.quadrature import PHASE, Decoder, levels_of
from rig_sim.board.encoder import QuadratureEncoder
from rig_sim.motion.trajectory import Nodes
from rig_sim.scenes.sections import Encoder
from stickslip.errors import InputError

from ..boards import DELTA


def encoder(decoder: str, vibration: float = 0.0, vibration_hz: float = 50.0) -> Encoder:
    return Encoder(
        lines_per_rev=4096,
        circumference=0.12566,
        decoder=decoder,  # type: ignore[arg-type]
        vibration=vibration,
        vibration_hz=vibration_hz,
    )


def swing(amplitude: float, omega: float, duration: float, nodes: int) -> Nodes:
    t = np.linspace(0, duration, nodes)
    return Nodes(t, amplitude * np.sin(omega * t), amplitude * omega * np.cos(omega * t))


@pytest.mark.parametrize("decoder", ["x4", "x1", "jk", "jk-latched"])
def test_the_edges_are_those_of_a_fine_sampling_of_the_levels(decoder: str) -> None:
    amplitude, omega, shake, hz = 12.3 * DELTA, 9.0, 1.7 * DELTA, 130.0
    nodes = swing(amplitude, omega, 2.0, 4001)
    reader = QuadratureEncoder(encoder(decoder, shake, hz), 0.0)
    counts = reader.read(nodes, np.arange(4001))

    fine = np.linspace(0, 2.0, 4_000_001)
    n = np.floor((amplitude * np.sin(omega * fine) + shake * np.sin(2 * np.pi * hz * fine)) / DELTA).astype(int)
    oracle = Decoder(decoder, levels=int(levels_of(n[0])))
    oracle.feed(levels_of(n))
    assert oracle.illegal == 0
    assert (counts.up[-1], counts.down[-1]) == (oracle.up, oracle.down)
    assert counts.up[-1] > 100
    np.testing.assert_array_equal(counts.levels, levels_of(n[::1000]))


@pytest.mark.parametrize("decoder", ["x4", "x1", "jk", "jk-latched"])
def test_counts_do_not_depend_on_how_the_motion_is_cut_into_stretches(decoder: str) -> None:
    nodes = swing(700 * DELTA, 5.9, 3.0, 3001)
    section = encoder(decoder, 2.2 * DELTA, 50.0)
    whole = QuadratureEncoder(section, 0.0).read(nodes, np.arange(3001))
    reader = QuadratureEncoder(section, 0.0)
    parts = []
    for first in range(0, 3000, 125):
        piece = slice(first, first + 126)
        part = Nodes(nodes.t[piece], nodes.x[piece], nodes.v[piece])
        parts.append(reader.read(part, np.arange(1, 126)))
    np.testing.assert_array_equal(np.concatenate([part.up for part in parts]), whole.up[1:])
    np.testing.assert_array_equal(np.concatenate([part.down for part in parts]), whole.down[1:])


@settings(max_examples=50)
@given(
    start=st.floats(-1e-2, 1e-2),
    amplitude=st.floats(0, 1e-2),
    omega=st.floats(0.1, 50),
    shake=st.floats(0, 1e-4),
    hz=st.floats(0, 500),
)
def test_x4_up_minus_down_is_the_position_and_its_phase_the_levels(
    start: float, amplitude: float, omega: float, shake: float, hz: float
) -> None:
    swung = swing(amplitude, omega, 0.5, 2001)
    nodes = Nodes(swung.t, swung.x + start, swung.v)
    reader = QuadratureEncoder(encoder("x4", shake, hz), start)
    counts = reader.read(nodes, np.arange(2001))
    net = counts.up - counts.down
    y = nodes.x + shake * np.sin(2 * np.pi * hz * nodes.t)
    position = net * DELTA + reader.origin
    assert np.abs(position - y).max() <= 0.5 * DELTA * (1 + 1e-6)
    np.testing.assert_array_equal(net % 4, PHASE[counts.levels])
    assert np.all(np.diff(counts.up) >= 0)
    assert np.all(np.diff(counts.down) >= 0)


def test_what_no_encoder_can_follow_is_refused_by_name() -> None:
    far = Nodes(np.array([0.0, 1.0]), np.array([0.0, 1e300]), np.array([0.0, 0.0]))
    with pytest.raises(InputError, match="no encoder can measure"):
        QuadratureEncoder(encoder("x4"), 0.0).read(far, np.array([1]))
    fast = Nodes(np.array([0.0, 1.0]), np.array([0.0, 1000.0]), np.array([1000.0, 1000.0]))
    with pytest.raises(InputError, match=r"edges in one part.*x4"):
        QuadratureEncoder(encoder("jk"), 0.0).read(fast, np.array([1]))
    assert QuadratureEncoder(encoder("x4"), 0.0).read(fast, np.array([1])).up[0] == int(1000.0 / DELTA)
