"""The terminal: results on stdout, progress and errors on stderr, one exit-code rule.

A command returns an `Answer`; `main` prints it as text, or with ``--json`` as a single JSON document.
Errors of `daq.errors` become one line on stderr, or ``{"error": {"what", "where", "do"}}`` on stdout under ``--json``;
what such an error has found out all the same goes to stdout, before the line or beside ``error``.
Nothing here imports numpy: arrays are written through their own ``tolist``.

What is printed decides nothing: a stderr that is closed, full or gone loses its lines and raises no error.  A result
that stdout does not take ends in exit code 3; the work is done then.
"""

import contextlib
import gc
import io
import json
import logging
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TextIO

import cyclopts

from daq.console import log
from daq.errors import EXIT_BUG, EXIT_DEVICE, EXIT_DONE, EXIT_INPUT, EXIT_INTERRUPTED, StickslipError

if TYPE_CHECKING:
    from rich.table import Table

# New objects between two searches for cyclic garbage.  Python's 700 costs a short command 4 % of its CPU time.
GARBAGE = 100_000
BAR = 16  # columns of a progress bar
WHOLE = ("next:", "-> ")  # how lines begin that name a command or a file
logger = logging.getLogger(__name__)

Json = Annotated[
    bool,
    cyclopts.Parameter(name="--json", negative=(), help="Print one JSON document to stdout and nothing else."),
]
SetChanges = Annotated[
    list[str] | None,
    cyclopts.Parameter(
        name="--set",
        negative=(),
        help="Change a scene: section.key=value; repeatable.",
        consume_multiple=False,
    ),
]


def whole(type_: type, tokens: Sequence[cyclopts.Token]) -> int:
    """Read a whole number for a flag (`1000`, `1e3`); a cyclopts converter.  ValueError for anything else."""
    value = float(tokens[0].value)
    if not value.is_integer():
        raise ValueError(f"{tokens[0].value} is not a whole number")
    return int(value)


Whole = cyclopts.Parameter(converter=whole)


@dataclass(frozen=True)
class Answer:
    """Result of a command: its JSON document, its text, its exit code.

    ``text`` is a string or a rich renderable (or a sequence of them), printed when ``--json`` was not given.
    """

    data: Any
    text: Any = ""
    exit_code: int = EXIT_DONE


def shown_default(value: Any) -> str | None:
    """Return the default of a flag as the help shows it; None for one that is off or empty."""
    return None if value is None or value is False or value in ("", ()) else str(value)


def application(name: str, summary: str = "", example: str = "", usage: str | None = None) -> cyclopts.App:
    """Return a cyclopts application with the settings common to all four commands; `main` runs it.

    Without a summary its help is that of its default command.
    """
    from daq.version import VERSION

    made = cyclopts.App(
        name=name,
        help=f"{summary}\n\nExample: {example}" if summary else None,
        usage=usage,
        help_epilogue=log.FLAGS,
        version=f"{name} {VERSION} (stickslip)",
        help_format="plaintext",
        result_action="return_value",
        suppress_keyboard_interrupt=False,
        default_parameter=cyclopts.Parameter(show_default=shown_default),
    )
    made.register_install_completion_command(help="Install completion of this command's words in your shell, and exit.")
    return made


def plain(value: Any) -> Any:
    """Return ``value`` as JSON types: arrays as lists, complex as [re, im], NaN and infinities as null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value


def shown(value: float, form: str) -> str:
    """Return a number as text in a format such as '.4g'; ``-`` where `plain` makes it null."""
    return format(value, form) if math.isfinite(value) else "-"


def print_json(value: Any) -> None:
    """Write one JSON document on stdout."""
    sys.stdout.write(json.dumps(plain(value), allow_nan=False) + "\n")
    sys.stdout.flush()


def note(line: str) -> None:
    """Write a line on stderr."""
    logger.debug(line)
    sys.stderr.write(_wrapped(line, sys.stderr) + "\n")


def _wrapped(text: str, stream: TextIO) -> str:
    """Return a text with its long lines broken between words where ``stream`` is a terminal: others read whole lines.

    A line that is to be copied into a shell (after ``next:``) stays whole.
    """
    if not stream.isatty():
        return text
    import shutil
    import textwrap

    width = shutil.get_terminal_size().columns
    return "\n".join(
        textwrap.fill(line, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
        if len(line) > width and not line.startswith(WHOLE)
        else line
        for line in text.split("\n")
    )


def _fail(name: str, error: StickslipError, code: int, as_json: bool) -> int:
    try:
        if as_json:
            print_json({"error": error.as_json()} | error.data)
            return code
        _print_text(error.lines)
    except OSError:
        _discard_stdout()
    note(f"{name}: {error}")
    return code


def _print_text(text: Any) -> None:
    parts = text if isinstance(text, list | tuple) else [text]
    for part in parts:
        if isinstance(part, str):
            if part:
                sys.stdout.write(_wrapped(part.rstrip("\n"), sys.stdout) + "\n")
        else:
            from rich.console import Console

            Console(soft_wrap=False).print(part)
    sys.stdout.flush()


def run(app: cyclopts.App, arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; the only place where errors become exit codes."""
    name = app.name[0]
    as_json = "--json" in arguments
    if as_json and "--version" in arguments:
        from daq.version import VERSION

        print_json({"command": name, "version": VERSION})
        return EXIT_DONE
    try:
        rest, flags = log.taken_off(arguments)
        if any(flag in rest for flag in app.help_flags):
            _reflow_help(app)
        with log.logging_to(flags, name, arguments):
            answer = app(rest, exit_on_error=False, print_error=False)
    except StickslipError as error:
        return _fail(name, error, error.exit_code, as_json)
    except cyclopts.CycloptsError as error:
        what = " ".join(str(error).split()).removesuffix(".")
        command = " ".join([name, *(error.command_chain or ())])
        usage = StickslipError(what, "command line", f"see '{command} --help'")
        return _fail(name, usage, EXIT_INPUT, as_json)
    except KeyboardInterrupt:
        return _fail(name, StickslipError("interrupted"), EXIT_INTERRUPTED, as_json)
    except BrokenPipeError:  # the reader of a help page has gone, as `| head` does
        _discard_stdout()
        return EXIT_DONE
    except OSError as error:
        do = "check the path, its permissions and the free space on the disk"
        refused = StickslipError(error.strerror or str(error), str(error.filename or name), do)
        return _fail(name, refused, EXIT_DEVICE, as_json)
    except Exception as error:
        if not as_json:
            raise
        do = "this is a bug: run it again without --json and report it"
        return _fail(name, StickslipError(f"{type(error).__name__}: {error}", name, do), EXIT_BUG, as_json)
    try:
        return _shown(answer, as_json)
    except BrokenPipeError:
        _discard_stdout()
        return answer.exit_code if isinstance(answer, Answer) else EXIT_DONE
    except OSError as error:  # an error in JSON could not be written there either
        _discard_stdout()
        what = f"the command is done, but its result could not be printed: {error.strerror or error}"
        unprinted = StickslipError(what, "stdout", "check the free space where stdout goes")
        code = _fail(name, unprinted, EXIT_DEVICE, as_json=False)
        return (answer.exit_code if isinstance(answer, Answer) else EXIT_DONE) or code


def _discard_stdout() -> None:
    """Let what waits to be printed go nowhere: at exit it would be an error again."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _shown(answer: object, as_json: bool) -> int:
    """Print what a command returned; return its exit code (help and version return no Answer)."""
    if not isinstance(answer, Answer):
        return EXIT_DONE
    if as_json:
        print_json(answer.data)
    else:
        _print_text(answer.text)
    return answer.exit_code


def _reflow_help(app: cyclopts.App) -> None:
    """Join the lines of each paragraph of the help pages: cyclopts breaks them anew, at the width of the terminal."""
    app.help = reflowed(app.help)
    for name in app:
        command = app[name]
        if command is not app and command.default_command is not None:
            command.help = reflowed(command.help)


def reflowed(text: str) -> str:
    """Return a docstring with each paragraph on one line, its section of parameters as it is."""
    import inspect

    words, header, parameters = inspect.cleandoc(text).partition("Parameters\n----------\n")
    return "\n\n".join([*(" ".join(part.split()) for part in words.split("\n\n")), header + parameters])


def main(app: cyclopts.App) -> NoReturn:
    """Run the process's own command line and exit; a bug shows its traceback and exits 1."""
    _open_standard_streams()
    gc.set_threshold(GARBAGE)
    code = run(app, sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the work is done, and a traceback of the way out would say otherwise
    gc.freeze()  # the interpreter does not search what is left on its way out
    sys.exit(code)


def _open_standard_streams() -> None:
    """Replace standard streams that the caller has closed by the null device, and make stderr raise nothing.

    A closed descriptor would be that of the next file that is opened, into which messages would then be written.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free descriptor, which is this one
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)
    buffer = getattr(sys.stderr, "buffer", None)
    if sys.stderr is None or isinstance(getattr(buffer, "raw", buffer), io.FileIO):  # not the console of Windows
        encoding = "utf-8" if sys.stderr is None else sys.stderr.encoding
        written = io.BufferedWriter(_UnfailingFile(2, "wb", closefd=False))
        sys.stderr = io.TextIOWrapper(written, encoding, "backslashreplace", line_buffering=True)


class _UnfailingFile(io.FileIO):
    """A file that takes everything: what the system refuses is dropped."""

    def write(self, data: Any) -> int:
        """Write what can be written; return the bytes that are dealt with."""
        everything = memoryview(data).nbytes
        try:
            written = super().write(data)
        except OSError:
            return everything
        return everything if written is None else written


def table(title: str, headings: Sequence[str], left: int = 1) -> "Table":
    """Return an empty table for 80 columns: the first ``left`` columns hold words, the others numbers."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    made = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for place, heading in enumerate(headings):
        made.add_column(heading, justify="left" if place < left else "right", no_wrap=place > 0)
    return made


class Progress:
    """What a long job calls with the amount done so far; it draws nothing where no bar is shown."""

    def __init__(
        self,
        update: Callable[..., None] = lambda **changes: None,
        restart: Callable[..., None] = lambda **changes: None,
    ) -> None:
        self._update, self._restart = update, restart
        self._stage = ""

    def __call__(self, done: float) -> None:
        """Show the amount done."""
        self._update(completed=done)

    def stage(self, description: str, done: float, total: float) -> None:
        """Show how much is done of one stage of the job; rate and ETA begin anew with every stage."""
        if description != self._stage:
            self._restart(description=description, total=total)
            self._stage = description
        self._update(completed=done)

    def status(self, words: str) -> None:
        """Show words in place of the rate."""
        self._update(words=words)


@contextmanager
def progress(description: str, total: float | None, unit: str = "") -> Iterator[Progress]:
    """Show a progress bar with rate and ETA on stderr, which fits 80 columns; yield what the job calls.

    Nothing is drawn when stderr is not a terminal.
    """
    if not sys.stderr.isatty():
        yield Progress()
        return
    from rich.console import Console
    from rich.progress import BarColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            each = f"{speed:.3g} {unit}/s" if speed and unit and unit != "%" else ""
            return Text(task.fields["words"] or each)

    class TimeLeft(TimeRemainingColumn):
        def render(self, task: Task) -> Text:
            unknown = task.finished or task.total is None
            return Text("") if unknown else Text("ETA ") + super().render(task)

    class Amount(ProgressColumn):
        def render(self, task: Task) -> Text:
            whole = "" if task.total is None else f"/{task.total:.0f}"
            return Text(f"{task.completed:.0f}{whole} {unit}")

    bar = Bar(
        TextColumn("{task.description}"),
        BarColumn(bar_width=BAR),
        Amount(),
        Rate(),
        TimeLeft(compact=True),
        console=Console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task(description, total=total, words="")
        yield Progress(partial(bar.update, task), partial(bar.reset, task))
