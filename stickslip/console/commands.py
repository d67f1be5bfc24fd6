"""The command `stickslip`: one word for each step of a record's way, which is a command of the four packages."""

from typing import NoReturn

from stickslip.console import application

HELP = """Identify the friction law of a stick-slip contact, in three steps:

1. stickslip record -o run.h5 records from a board or from the simulated rig; stickslip import track.csv -o run.h5
converts a table.

2. stickslip smooth run.h5 estimates the velocity and detects sticks and slips.

3. stickslip fit run.h5 ranks the friction laws and writes the report, run.report.html.

The commands 'daq', 'process', 'fit-friction' and 'rig-sim' offer these steps and more (see 'daq --help')."""

# In the order of the help: the word, where the command is, and what it does.  It is imported on use.
COMMANDS = (
    ("record", "daq.cli.record:record", "daq record: record a run from a board or the simulated rig."),
    ("import", "daq.cli.files:import_table", "daq import: convert a table to a run file."),
    ("smooth", "processing.cli:smooth", "process smooth: estimate the motion, sticks and slips of a run."),
    ("fit", "fitting.cli:fit", "fit-friction: fit the friction laws to runs, rank them, and write a report."),
    ("list", "daq.cli.notes:list_runs", "daq list: list runs with their notes and verdicts."),
    ("watch", "daq.cli.live:watch", "daq watch: show a run, or a recording that is running, in the browser."),
    ("export", "daq.cli.files:export", "daq export: write a run as a table."),
    ("demo", "daq.cli.setup:demo", "daq demo: simulate, record and fit an example in a new folder."),
    ("doctor", "daq.cli.setup:doctor", "daq doctor: check the installation."),
)

SIM = """rig-sim: simulate the rig and analyse its cycles, events, motion and bifurcations.

Example: rig-sim cycle base"""
USAGES = {"fit": "Usage: stickslip fit [OPTIONS] RUN.h5 [RUN.h5 ...]"}

app = application.application("stickslip", HELP, "stickslip demo")
for place, (word, home, summary) in enumerate(COMMANDS):
    app.command(home, name=word, help=summary, sort_key=place, usage=USAGES.get(word))
# An application has a name of its own, and the word is another one for it.
app.command("rig_sim.cli.app:app", name=(), alias="sim", help=SIM, sort_key=len(COMMANDS))


def main() -> NoReturn:
    """Run the command line."""
    application.main(app)


if __name__ == "__main__":
    main()
