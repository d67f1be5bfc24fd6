"""The terminal: results on stdout, progress and errors on stderr, one exit-code rule.

A command returns an `Answer`; `main` prints it as text, or with ``--json`` as a single JSON document.
Errors of `stickslip.errors` become one line on stderr, or ``{"error": {"what", "where", "do"}}`` on stdout under
``--json``; what such an error has found out all the same goes to stdout, before the line or beside ``error``.
Nothing here imports numpy: arrays are written through their own ``tolist``.

What is printed decides nothing: a stderr that is closed, full or gone loses its lines and raises no error.  A result
that stdout does not take ends in exit code 3; the work is done then.  A reader that goes away (`| head`) is no error.

Text may come from a board, a file or a path.  All of it goes to the terminal through `stickslip.text.printable`, in the
encoding of the stream: control characters are printed as escapes, and characters that the encoding lacks are spelled.
"""

import contextlib
import errno
import gc
import io
import json
import logging
import math
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TextIO

import cyclopts

from stickslip.compute.interpreter import ignore_settings
from stickslip.console import log
from stickslip.console.flags import OUTPUT
from stickslip.console.termination import end_by_signal, heed_signals
from stickslip.errors import EXIT_BUG, EXIT_DEVICE, EXIT_DONE, EXIT_INPUT, EXIT_INTERRUPTED, StickslipError
from stickslip.text import SPELLED, printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

# New objects between two searches for cyclic garbage.  Python's 700 costs a short command 4 % of its CPU time.
GARBAGE = 100_000
BAR = 16  # columns of a progress bar
WHOLE = ("next:", "-> ")  # how lines begin that name a command or a file
# What is most likely wanted of a file that stands where a command should, by the end of its name.
COMMAND_OF_FILE = {".h5": "process smooth", ".part": "daq recover", ".toml": "rig-sim events"}
COMMAND_OF_FILE |= dict.fromkeys((".csv", ".tsv", ".txt", ".mat", ".xlsx", ".lvm", ".tdms"), "daq import")
# Words of `stickslip` that are typed after another command.
COMMAND_OF_WORD = {
    "fit": "fit-friction",
    "rank": "fit-friction",
    "smooth": "process smooth",
    "inspect": "process inspect",
}
COMMAND_OF_WORD |= {"record": "daq record", "import": "daq import", "list": "daq list", "cycle": "rig-sim cycle"}
logger = logging.getLogger(__name__)

Json = Annotated[
    bool,
    cyclopts.Parameter(name="--json", negative=(), group=OUTPUT, help="Print one JSON document and nothing else."),
]
SetChanges = Annotated[
    list[str] | None,
    cyclopts.Parameter(
        name="--set",
        negative=(),
        help="Change the scene, as in section.key=value; repeatable.",
        consume_multiple=False,
    ),
]


def read_whole(type_: type, tokens: Sequence[cyclopts.Token]) -> int:
    """Read a whole number for a flag (`1000`, `1e3`); a cyclopts converter.  ValueError for anything else."""
    value = float(tokens[0].value)
    if not value.is_integer():
        raise ValueError(f"{tokens[0].value} is not a whole number")
    return int(value)


Whole = cyclopts.Parameter(converter=read_whole)


@dataclass(frozen=True)
class Answer:
    """Result of a command: its JSON, its text (strings and rich renderables), its exit code."""

    data: Any
    text: Any = ""
    exit_code: int = EXIT_DONE
    printed: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)


def format_default(value: Any) -> str | None:
    """Return the default of a flag as the help shows it; None for one that is off or empty."""
    return None if value is None or value is False or value in ("", ()) else str(value)


def application(name: str, summary: str = "", example: str = "", usage: str | None = None) -> cyclopts.App:
    """Return a cyclopts application with the settings common to all commands; without summary its default's help."""
    from stickslip.version import VERSION

    app = cyclopts.App(
        name=name,
        help=f"{summary}\n\nExample: {example}" if summary else None,
        usage=usage,
        help_epilogue=log.FLAGS,
        version=f"{name} {VERSION} (stickslip)",
        help_format="plaintext",
        result_action="return_value",
        suppress_keyboard_interrupt=False,
        default_parameter=cyclopts.Parameter(show_default=format_default),
    )
    app.register_install_completion_command()
    for flag in ("--help", "--version", "--install-completion"):  # the epilogue names them
        app[flag].show = False
    return app


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


def print_json(value: Any) -> None:
    sys.stdout.write(json.dumps(plain(value), allow_nan=False) + "\n")
    sys.stdout.flush()


def note(line: str) -> None:
    logger.debug(line)
    _write(line + "\n", sys.stderr)


def ask(line: str) -> None:
    """Write a question on stderr, and wait for Enter on stdin."""
    _write(line, sys.stderr)
    sys.stderr.flush()
    sys.stdin.readline()


def _write(text: str, stream: TextIO) -> None:
    """Write text of any origin on a stream that may be a terminal."""
    stream.write(_wrap_lines(printable(text, stream.encoding), stream))


def _console(stderr: bool = False, markup: bool = False) -> "Console":
    """Return rich's console, for tables, bars and help pages."""
    from rich.console import Console

    class Printing(Console):
        def render_str(self, text: str, **how: Any) -> "Text":
            return super().render_str(printable(text, self.encoding), **how)

        def on_broken_pipe(self) -> None:  # rich's own ends the process with exit code 1
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))

    return Printing(stderr=stderr, markup=markup, emoji=False, soft_wrap=False)


def _wrap_lines(text: str, stream: TextIO) -> str:
    """Break long lines between words on a terminal, except those to be copied into a shell (``next:``)."""
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
    note(f"{name}: {error.as_line()}")
    return code


def _print_text(text: Any) -> None:
    parts = text if isinstance(text, list | tuple) else [text]
    for part in parts:
        if isinstance(part, str):
            if part:
                _write(part.rstrip("\n") + "\n", sys.stdout)
        else:
            _console().print(part)
    sys.stdout.flush()


def run(app: cyclopts.App, arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; the only place where errors become exit codes."""
    name = app.name[0]
    as_json = "--json" in arguments
    if as_json and "--version" in arguments:
        from stickslip.version import VERSION

        return _print_answer(name, Answer({"command": name, "version": VERSION}), as_json)
    try:
        rest, flags = log.take_log_flags(arguments)
        if any(flag in rest for flag in app.help_flags):
            _reflow_help(app, rest)
        if any(flag in rest for flag in (*app.help_flags, *app.version_flags)):
            app.console = _console(markup=True)
        with log.log_to(flags, name, arguments):
            answer = app(rest, exit_on_error=False, print_error=False)
    except StickslipError as error:
        error.do = _suggest_quotes(error.where, arguments) or error.do
        return _fail(name, error, error.exit_code, as_json)
    except cyclopts.CycloptsError as error:
        return _fail(name, _explain_usage(error, name, rest), EXIT_INPUT, as_json)
    except KeyboardInterrupt:  # also of SIGTERM and SIGHUP
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
    return _print_answer(name, answer, as_json)


def _explain_usage(error: cyclopts.CycloptsError, name: str, words: Sequence[str]) -> StickslipError:
    """Return a mistake of the command line, with what to type."""
    command = " ".join([name, *(error.command_chain or ())])
    what, hint = " ".join(str(error).split()).removesuffix("."), ""
    if isinstance(error, cyclopts.UnknownCommandError):
        if meant := _suggest_command(error, name, words):
            return meant
        what = what.partition(" Available commands")[0] if "Did you mean" in what else what
    elif isinstance(error, cyclopts.UnusedCliTokensError):
        unused = error.unused_tokens or []
        what = f"nothing takes {', '.join(map(repr, unused))}"
        hint = _suggest_quotes(unused[0], words)
    elif (
        isinstance(error, cyclopts.UnknownOptionError)
        and (flag := error.token.keyword or error.token.value)[1:2] != "-"
    ):
        what = f"Unknown option: {flag}"
        hint = f"did you mean '-{flag}'?" if len(flag) > 2 else ""
    elif isinstance(error, cyclopts.MissingArgumentError):
        what = (
            what.removeprefix(f'Command "{command.split()[-1]}" ')
            .replace("parameter ", "", 1)
            .removeprefix("Parameter ")
        )
        example = re.search(r"Example: (.*)", getattr(error.target, "__doc__", None) or "")
        if error.keyword and error.argument is not None:
            hint = f"write a value after {error.keyword}: {error.argument.parameter.help}".removesuffix(".")
        elif example:
            hint = f"as in '{example[1]}'"
    elif isinstance(error, cyclopts.CoercionError) and error.token is not None and error.target_type in (int, float):
        kind = "whole number" if error.target_type is int else "number"
        what, hint = f"{error.token.keyword} is {error.token.value!r}, not a {kind}", f"use a {kind}"
    return StickslipError(what, "command line", "; ".join(filter(None, [hint, f"see '{command} --help'"])))


def _suggest_quotes(word: str, words: Sequence[str]) -> str:
    """Return what to type where a word is the unit of the value before it; "" where it is not."""
    place = words.index(word) if word in words and not word.startswith("-") else 0
    if (
        place < 2
        or not words[place - 2].startswith("--")
        or not re.fullmatch(r"[-+.\d]+(e[-+]?\d+)?", words[place - 1])
    ):
        return ""
    return f"put a value with a space in quotes: {words[place - 2]} '{words[place - 1]} {word}'"


def _suggest_command(error: cyclopts.CycloptsError, name: str, words: Sequence[str]) -> StickslipError | None:
    """Return an error for a file in place of a command, with the line that was most likely meant; else None."""
    import shlex

    if not isinstance(error, cyclopts.UnknownCommandError) or not error.unused_tokens:
        return None
    if error.unused_tokens[0] in COMMAND_OF_WORD:
        line = " ".join(map(shlex.quote, [*COMMAND_OF_WORD[words[0]].split(), *words[1:]]))
        return StickslipError(f"{words[0]!r} is not a command of {name}", "command line", f"did you mean '{line}'?")
    file = next((word for word in words if os.path.splitext(word)[1].lower() in COMMAND_OF_FILE), None)
    if file is None or not (error.unused_tokens[0] == file or error.unused_tokens[0].startswith("-")):
        return None
    words_meant = COMMAND_OF_FILE[os.path.splitext(file)[1].lower()].split()
    line = " ".join(map(shlex.quote, [*words_meant, *(words if words_meant[0] == name else [file])]))
    return StickslipError(f"{file!r} is a file, not a command", "command line", f"did you mean '{line}'?")


def _print_answer(name: str, answer: object, as_json: bool) -> int:
    """Print what a command returned; return the exit code, also of a stdout that cannot be written."""
    try:
        with answer.printed if isinstance(answer, Answer) else contextlib.nullcontext():
            return _show_answer(answer, as_json)
    except OSError as error:
        _discard_stdout()
        if error.errno in (errno.EPIPE, errno.EIO):  # the reader has gone: a pipe, or a terminal that was closed
            return answer.exit_code if isinstance(answer, Answer) else EXIT_DONE
        # an error in JSON could not be written there either
        what = f"the command is complete, but its result could not be printed: {error.strerror or error}"
        unprinted = StickslipError(what, "stdout", "check the free space at the destination of stdout")
        return _fail(name, unprinted, EXIT_DEVICE, as_json=False)


def _discard_stdout() -> None:
    """Discard what is still to be printed: at exit it would be an error again."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_answer(answer: object, as_json: bool) -> int:
    """Print what a command returned; return its exit code (help and version return no Answer)."""
    if not isinstance(answer, Answer):
        return EXIT_DONE
    if as_json:
        print_json(answer.data)
    else:
        _print_text(answer.text)
    return answer.exit_code


def _reflow_help(app: cyclopts.App, words: Sequence[str]) -> None:
    """Join the lines of each paragraph of the requested help page: cyclopts wraps them at the terminal's width."""
    for requested in app.parse_commands(words)[1]:
        loaded = [command for command in requested._commands.values() if isinstance(command, cyclopts.App)]  # noqa: SLF001
        for page in (requested, *loaded):
            docstring = None if page.default_command is None else page.default_command.__doc__
            page.help = reflow(docstring or page.help)


def reflow(text: str) -> str:
    """Return a docstring with each paragraph on one line, its section of parameters as it is."""
    import inspect

    words, header, parameters = inspect.cleandoc(text).partition("Parameters\n----------\n")
    return "\n\n".join([*(" ".join(part.split()) for part in words.split("\n\n")), header + parameters])


def main(app: cyclopts.App) -> NoReturn:
    """Run the process's own command line and exit; a bug shows its traceback and exits 1."""
    _open_standard_streams()
    sys.excepthook = _show_bug
    ignore_settings()
    heed_signals()
    gc.set_threshold(GARBAGE)
    code = run(app, sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the work is done, and a traceback of the way out would say otherwise
    end_by_signal()
    gc.freeze()  # the interpreter does not search what is left on its way out
    sys.exit(code)


def _show_bug(kind: type[BaseException], error: BaseException, where: TracebackType | None) -> None:
    import traceback

    sys.stderr.write(printable("".join(traceback.format_exception(kind, error, where)), sys.stderr.encoding))


def _open_standard_streams() -> None:
    """Replace closed standard streams by the null device, so that no file gets their numbers; stderr raises nothing."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free descriptor, which is this one
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors=SPELLED)
    buffer = getattr(sys.stderr, "buffer", None)
    if sys.stderr is None or isinstance(getattr(buffer, "raw", buffer), io.FileIO):  # not the console of Windows
        encoding = "utf-8" if sys.stderr is None else sys.stderr.encoding
        written = io.BufferedWriter(_UnfailingFile(2, "wb", closefd=False))
        sys.stderr = io.TextIOWrapper(written, encoding, SPELLED, line_buffering=True)


class _UnfailingFile(io.FileIO):
    """A file whose failed writes are dropped."""

    def write(self, data: Any) -> int:
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

    empty = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for column, heading in enumerate(headings):
        empty.add_column(heading, justify="left" if column < left else "right", no_wrap=column > 0)
    return empty


def verdict(sentences: str, laws: int) -> "str | Text":
    """Return the verdict as its line; on a terminal in the colour of how many laws it leaves: one, several, or none."""
    line = f"verdict: {sentences}"
    if not sys.stdout.isatty():
        return line
    from rich.text import Text

    return Text(printable(line, sys.stdout.encoding), style=("bold red", "bold green", "bold yellow")[min(laws, 2)])


class Progress:
    """What a long job calls with the amount done so far; without a bar it draws nothing."""

    def __init__(
        self,
        update: Callable[..., None] = lambda **changes: None,
        restart: Callable[..., None] = lambda **changes: None,
    ) -> None:
        self._update, self._restart = update, restart
        self._stage = ""

    def __call__(self, done: float) -> None:
        self._update(completed=done)

    def stage(self, description: str, done: float, total: float | None) -> None:
        """Show how much is done of a stage of the job, None for unknown; rate and ETA restart with every stage."""
        if description != self._stage:
            self._restart(description=description, total=total)
            self._stage = description
        self._update(completed=done)

    def status(self, words: str) -> None:
        """Show words in place of the rate."""
        self._update(words=words)


@contextmanager
def progress(description: str, total: float | None, unit: str = "") -> Iterator[Progress]:
    """Show a progress bar with rate and ETA on stderr, if that is a terminal; yield what the job calls."""
    if not sys.stderr.isatty():
        yield Progress()
        return
    from rich.progress import BarColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            each = f"{speed:.3g} {unit}/s" if speed and unit and unit != "%" else ""
            return Text(printable(task.fields["words"], sys.stderr.encoding) or each)

    class TimeLeft(TimeRemainingColumn):
        max_refresh = 0.0  # rich keeps a text for half a second: a new stage would show that of the one before

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
        console=_console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task(description, total=total, words="")
        yield Progress(partial(bar.update, task), partial(bar.reset, task))
