"""The command `daq`: record a run, get runs from elsewhere, look after both."""

from typing import NoReturn

from daq import cli_board, cli_files, cli_firmware, cli_record, cli_setup, terminal

app = terminal.application(
    "daq", "Record stick-slip runs from an encoder board or the simulated rig.", "daq record --rate 1000 -o run.h5"
)
cli_record.register(app)
cli_board.register(app)
cli_files.register(app)
cli_setup.register(app)
cli_firmware.register(app)


def main() -> NoReturn:
    """Run the command line."""
    terminal.main(app)


if __name__ == "__main__":
    main()
