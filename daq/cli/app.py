"""The command `daq`: record runs, import them, and work with their files."""

from typing import NoReturn

from daq.cli import board, files, firmware, live, notes, record, setup
from stickslip.console import application

app = application.application(
    "daq", "Record stick-slip runs from an encoder board or the simulated rig.", "daq record --rate 1000 -o run.h5"
)
record.register(app)
live.register(app)
board.register(app)
files.register(app)
notes.register(app)
setup.register(app)
firmware.register(app)


def main() -> NoReturn:
    """Run the command line."""
    application.main(app)


if __name__ == "__main__":
    main()
