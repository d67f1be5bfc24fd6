"""Flags that take quantities: every one reads a minus and, where it is of use, an error, as it is typed."""

from typing import Annotated

import cyclopts
import pytest

from stickslip.console import application, flags
from stickslip.console.application import Answer
from stickslip.units import Measured


@pytest.fixture
def app() -> cyclopts.App:
    made = application.application("try", "flags", "try --x 1")

    @made.default
    def command(
        *,
        x: Annotated[Measured | None, flags.measured("--x", "length", "A place.")] = None,
        speed: Annotated[Measured | str | None, flags.measured("--speed", "speed", "One.", word="channel")] = None,
        until: Annotated[float | None, flags.quantity("--until", "time", "A time.")] = None,
    ) -> Answer:
        return Answer([repr(x), repr(speed), until], f"{x} {speed} {until}")

    return made


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        (["--x", "-60 mm +- 0.1 mm"], f"{Measured(-0.06, 1e-4)} None None"),  # "-60 mm" was taken for a flag
        (["--x=-60 mm"], f"{Measured(-0.06)} None None"),
        (["--x", "-0.06"], f"{Measured(-0.06)} None None"),
        (["--speed", "channel"], "None channel None"),
        (["--speed", "-0.5 m/s", "--until", "-2 s"], f"None {Measured(-0.5)} -2.0"),
    ],
)
def test_a_negative_quantity_stands_after_a_blank(
    app: cyclopts.App, capsys: pytest.CaptureFixture[str], words: list[str], printed: str
) -> None:
    assert application.run(app, words) == 0
    assert capsys.readouterr().out == f"{printed}\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--x", "--until", "3"], "try: --x: has no value, because '--until' is also a flag"),
        (["--x"], "--x"),
        (["--x", "-mm"], "'-mm' is not a valid length"),
        (["--until", "2 s +- 1 s"], "--until: '2 s +- 1 s' has an error, which is not accepted here"),
    ],
)
def test_a_missing_value_and_an_error_of_no_use_are_refused(
    app: cyclopts.App, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    """'mm +- 0.1 mm' was called no unit of length."""
    assert application.run(app, words) == 2
    assert said in capsys.readouterr().err
