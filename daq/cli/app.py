"""The command `daq`: record runs, import them, and work with their files."""

from collections.abc import Callable
from typing import NoReturn

from daq.cli import board, files, firmware, live, notes, record, setup
from stickslip.console import application
from stickslip.console.application import Answer

app = application.application(
    "daq", "Record stick-slip runs from an encoder board or the simulated rig.", "daq record --rate 1000 -o run.h5"
)
COMMANDS: tuple[Callable[..., Answer], ...] = (
    *(record.record, record.recover, record.ports, live.watch, board.check, board.calibrate),
    *(files.import_table, files.replay, files.decode, files.export, notes.note, notes.list_runs),
    *(setup.doctor, setup.demo, firmware.firmware),
)
NAMES = {files.import_table: "import", notes.list_runs: "list"}  # Python has words of these names
for command in COMMANDS:
    app.command(command, name=NAMES.get(command))


def main() -> NoReturn:
    """Run the command line."""
    application.main(app)


if __name__ == "__main__":
    main()
