"""What is no scene is refused in one line that names the key or the file, and says what to do."""

import pytest

from rig_sim.scenes.scene import parse_changes, scene
from stickslip.errors import InputError

FINITE = "mass.m spring.k friction.Fs friction.gamma belt.speed start.x damper.c drive.u0".split()
LUGRE = ["friction.law=lugre", "friction.s0=15 N/mm", "friction.s1=60", "friction.Fc=600 mN", "friction.v_s=10 cm/s"]
HYPERBOLA = "friction.formula=Fs/(1 + gamma*s)"
DROOP = "droop.fraction=0.01"
SHAKER = ["shaker.a=0.3", "shaker.phi=3.0"]
NARROW = ["friction.law=6", "friction.G_stick=-5", "belt.speed=0.1"]

CHANGES = [  # scene, its changes, words of the refusal
    # names
    ("base", ["frction.law=3"], "frction", "did you mean 'friction'"),
    ("base", ["friction.gama=3"], "friction.gama", "did you mean 'gamma'"),
    ("base", ["sed=1"], "sed", "did you mean 'seed'"),
    ("base", ["mass=3"], "mass is 3"),
    ("base", ["seed.x=3"], "seed", "no key 'x'"),
    ("base", ["friction.Fs"], "section.key=value"),
    # numbers
    *(("base", [f"{key}={value}", "drive.omega=1"], key) for key in FINITE for value in ("nan", "inf", "-inf")),
    *(
        ("base", [f"{key}={value}"], key, "1e-100 to 1e+100")
        for key, value in (("mass.m", 1e-300), ("spring.k", 1e300), ("start.x", -1e101), ("belt.speed", 1e-101))
    ),
    *(("base", [f"{key}={value}"], key, value) for key in ("mass.m", "spring.k") for value in ("-1", "0", "-1e-300")),
    ("base", ["friction.Fs=-1"], "friction.Fs", "-1"),
    ("base", ["friction.G_stick=5"], "friction.G_stick", "5"),
    ("base", ["friction.law=7"], "friction.law", "7"),
    ("base", ["friction.static=0.9"], "friction.static", "0.9"),
    ("base", ["belt.start=-1"], "belt.start", "-1"),
    ("base", ["drive.u0=0.2"], "drive.omega is missing"),
    ("base", ["joint.kick=0.1"], "the section joint requires belt.length"),
    *(("rig", ["mass.m=" + much], said) for much, said in (("9" * 5000, "mass.m"), ("0x" + "f" * 5000, "mass.m"))),
    ("rig", ["mass.m=" + "[" * 5000], "nested too deeply"),  # a RecursionError
    # the board
    ("rig", ["encoder.decoder=x5"], "encoder.decoder", "x5"),
    ("base", ["slip_loss.rate=1"], "slip_loss.counts is missing"),
    ("base", ["gaps={rate=1, duration=1}"], "gaps requires an encoder"),
    ("base", ["gaps={rate=0, duration=1}"], "gaps.rate", "0"),
    ("base", ["belt.channel=true"], "belt.channel requires an encoder"),
    ("rig", ["belt.channel=3"], "belt.channel"),
    # a belt that ripples or droops, a shaker
    ("base", ["belt.ripple=1"], "belt.ripple_hz is missing"),
    ("base", ["belt={speed=0.5, ripple=0.1, ripple_hz=0}"], "belt.ripple_hz", "0"),
    ("forced", ["belt.ripple=0.05", "belt.ripple_hz=0.31"], "belt.ripple cannot be combined with a drive"),
    ("rig", [DROOP, "friction.static=1.2"], "static"),
    ("rig", ["droop.fraction=0.5"], "fraction is 0.5", "use less than 0.4726"),
    ("rig", [DROOP, "friction.Fs=0.0"], "Fs"),
    ("base", ["droop.fraction=0.1", HYPERBOLA], "droop with friction.formula is not modelled"),
    ("base", [*SHAKER, "belt.speed=0"], "set belt.speed"),
    ("base", [*SHAKER, "shaker.a=-1"], "shaker.a"),
    ("base", [*SHAKER, "shaker.phase=1"], "unknown key 'shaker.phase'"),
    ("base", ["shaker.a=5", "shaker.phi=3.1"], "shaker.a = 5, shaker.phi = 3.1: the mass would creep"),
    ("base", ["shaker.a=0.5", "shaker.phi=2.2", *NARROW], "creep"),
    # two masses
    ("two-mass", ["friction.law=6"], "ramp"),
    ("two-mass", ["drive={u0=1, omega=1}"], "drive is not modelled for two masses"),
    ("two-mass", ["belt.ripple=0.1"], "belt.ripple"),
    ("two-mass", ["start.x=0.1"], "start.x and"),
    ("two-mass", ["coupling.a=-1"], "coupling.a"),
    ("two-mass", [HYPERBOLA], "friction.formula is given, which is not modelled for two masses"),
    ("base", ["start.d=0.1"], "requires the section coupling"),
    # a measured curve
    ("base", ["friction.law=0"], "law 0 requires friction.curve"),
    *(
        ("base", ["friction.law=0", f"friction.curve={curve}"], said)
        for curve, said in (
            ("[[0.0, 1.0]]", "1 point"),
            ("[[0.0, 1.0], [0.5, 0.8], [0.3, 0.7]]", "increase"),
            ("[[0.0, 1.0], [0.5, 0.8], [0.5, 0.7]]", "increase"),
            ("[[-0.1, 1.0], [0.5, 0.8]]", "below 0"),
            ("[[0.1, 1.0], [0.5, 0.8]]", "begins at s = 0.1"),
            ("[[0.0, 1.0], [0.5, -0.8]]", "not above 0"),
            ("[[0.0, 1.0], [0.5, nan]]", "finite"),
            ("[[0.0, 1.0], [0.5]]", "curve"),
        )
    ),
    # laws with memory
    ("rig", LUGRE[:1], "law lugre requires friction.s0; set s0 in N/m, Fc in N, v_s in m/s"),
    ("rig", ["friction.law=lugra"], "'lugra'; it should be 0, 1, 2, 3, 4, 5, 6, lugre, dahl, ageing or slip"),
    ("rig", ["friction.v_s=0.1"], "unknown key 'friction.v_s'"),
    *(
        ("rig", [*LUGRE, change], said)
        for change, said in (
            ("friction.s0=0", "friction.s0 is 0; use a number above 0"),
            ("friction.s1=-1", "friction.s1 is -1; use a number 0 or more"),
            ("friction.s0=3 mm", "friction.s0: 'mm' is not a unit of stiffness"),
            ("belt.speed=0", "requires a moving belt; set belt.speed"),
            ("friction.static=1.2", "friction.static cannot be combined with law lugre"),
            ("friction.contact=jump", "friction.contact cannot be combined with law lugre"),
            ("droop.fraction=0.1", "droop is not modelled with law lugre"),
            ("shaker={a=1, phi=0}", "shaker is not modelled with law lugre"),
        )
    ),
]


def assert_named(error: InputError, words: tuple[str, ...]) -> None:
    for word in words:
        assert word in error.as_line()
    assert error.do


@pytest.mark.parametrize(
    ("name", "changes", "words"), [(*row[:2], row[2:]) for row in CHANGES], ids=[row[2] for row in CHANGES]
)
def test_a_change_is_refused_by_name(name, changes, words):
    with pytest.raises(InputError) as caught:
        scene(name, **parse_changes(changes))
    assert "\n" not in caught.value.as_line()
    assert_named(caught.value, words)


BARE = "[mass]\nm = 1\n[spring]\nk = 1\n[belt]\nspeed = 0.5\n"
FILES = [  # content, words of the refusal
    (b"[mass\nm = 1\n", "invalid TOML"),
    (b"a = " + b"[" * 5000, "nested too deeply"),  # a RecursionError
    (b"\xff\xfe\x00", "is not a text file"),
    (b"", "mass is missing"),
    (b"# much\n" * 200_000, "too large for a scene: over 1048576 bytes"),
    (b"[mass]\nm = 1\n[spring]\nk = 1\nkk = 3\n", "unknown key 'spring.kk'; did you mean 'k'"),
    *(
        (f"{BARE}[friction]\n{friction}\n".encode(), *said)
        for friction, *said in (
            ("Fs = 1.0", "friction.law is missing"),
            ("law = 6\nFs = 1\ngamma = 3\nd = 0.2\nG_stick = -5", "both G_stick and d"),
            ("law = 5\nFs = 1.0\ngamma = 3.0\nv_s = 1.0", "unknown key 'friction.v_s'"),
            ('formula = "Fc + b*s"\nFc = 1.0', "the formula requires friction.b"),
            ('formula = "Fc*exp(-s/v_s)"\nFc = 1.0\nvs = 0.1', "unknown key 'friction.vs'; did you mean 'v_s'?"),
            (
                'formula = "Fc*exp(-gama*s)"\nFc = 1\ngamma = 3',
                "the formula requires friction.gama",
                "did you mean 'gamma'?",
            ),
            ('formula = "Fc"\nFc = 1.0\nlaw = 1', "both law and formula"),
            ('formula = "Fc"\nFc = 1.0\ncurve = [[0.0, 1.0]]', "both curve and formula"),
            (
                'formula = "Fc - d*s"\nFc = 1\nd = 0.1',
                "parameter d, which is a key of the section: half-width of the ramp",
            ),
            ('formula = "Fc"\nFc = 1.0\ncontact = "ramp"', "a ramp requires friction.d"),
            ('formula = "Fc"\nFc = "1"', "friction.Fc is '1'"),
            ('formula = "Fc"\nFc = nan', "friction.Fc is nan"),
            ("formula = 3", "friction.formula is 3"),
            ('formula = "Fc*(1 - s"\nFc = 1.0', "friction.formula: this bracket is not closed", "^"),
            ('formula = "Fc - log(s)"\nFc = 1', "friction.formula: friction is not finite at s = 0 m/s", "log of 0"),
        )
    ),
]


@pytest.mark.parametrize(("content", "words"), [(row[0], row[1:]) for row in FILES], ids=[row[1] for row in FILES])
def test_a_file_is_refused_by_its_name(tmp_path, content, words):
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        scene(path)
    assert str(path) in caught.value.as_line()
    assert_named(caught.value, words)


def test_a_scene_that_is_not_there_is_refused_with_the_nearest_name(tmp_path):
    with pytest.raises(InputError, match="did you mean 'base'"):
        scene("bse")
    with pytest.raises(InputError, match="no such file"):
        scene(tmp_path / "none.toml")
