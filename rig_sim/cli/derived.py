"""Commands made from the functions of `rig_sim`: their flags, defaults and help are those of the function.

The function is read as text and imported when the command runs: a help page loads no numerical package.
"""

import ast
import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter, Token

from rig_sim import HOMES
from stickslip.console import application, flags
from stickslip.console.application import Answer, Json, SetChanges
from stickslip.console.flags import Force, Plot, check_plot
from stickslip.errors import InputError

if TYPE_CHECKING:
    from rig_sim.results.result import Result
    from rig_sim.scenes.model import Scene

ENTRY = re.compile(r"^(\w+) : .*\n((?:    .*\n?)+)", re.MULTILINE)  # of a section Parameters
IN_PYTHON = re.compile(r" In Python .*?\.(?= |$)")  # a sentence that only Python needs
CHOICES = re.compile(r"^(\w+) = (Literal\[.*\])$", re.MULTILINE)
COMMAND_NAME = re.compile(r": ``rig-sim [\w-]+``(?=\.$)", re.MULTILINE)  # at the end of a summary


def derive(
    name: str,
    *examples: str,
    plots: bool = False,
    required: str = "",
    within: Callable[[dict[str, Any]], AbstractContextManager[Any]] = nullcontext,
) -> Callable[..., Answer]:
    """Return the command of the function ``name``; ``within`` takes the flags, and is open while the function runs."""
    definition = read_definition(name)
    words, helps = read_help(definition)
    derived = list(read_parameters(definition, helps, required))
    names = {parameter.name for parameter in derived}
    takes_scene, shows_progress = "scene" in names, "progress" in {each.arg for each in definition.args.kwonlyargs}
    more: dict[str, Any] = {"plot": (Plot, None)} if plots else {}
    more |= {"force": (Force, False)} if plots or "force" in names else {}
    more |= {"set_": (SetChanges, None)} if takes_scene else {}
    more |= {"json": (Json, False)}
    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = [parameter for parameter in derived if parameter.name != "force"]
    parameters += [
        inspect.Parameter(flag, keyword, default=default, annotation=kind) for flag, (kind, default) in more.items()
    ]

    def command(*scenes: str, json: bool = False, set_: list[str] | None = None, **values: Any) -> Answer:
        import rig_sim

        with within(dict(values)):
            plot, force = values.pop("plot", None), values.get("force", False)
            if "force" not in names:
                values.pop("force", None)
            check_plot(plot, force)
            with application.progress(name, None) as bar:
                values |= {"progress": bar.stage} if shows_progress else {}
                result = getattr(rig_sim, name)(*(load_changed(scene, set_) for scene in scenes), **values)
        return make_answer(result, plot, force)

    command.__name__ = name
    command.__doc__ = "\n\n".join([words, *(f"Example: {example}" for example in examples)])
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def load_changed(name: str, changes: list[str] | None) -> "Scene":
    from rig_sim.scenes.scene import parse_changes, scene

    return scene(name, **parse_changes(changes))


def make_answer(result: "Result", plot: Path | None, force: bool) -> Answer:
    """Return a result as the command's answer; ``plot``: drawn into this file, which the answer names."""
    data: dict[str, Any] = result.as_json()
    lines = result.lines()
    if plot is not None and (nothing := result.undrawn()):
        lines = [*lines, f"nothing drawn: {nothing}"]
    elif plot is not None:
        from stickslip.output.plot import save

        save(result.plot(), plot, force=force)
        data["file"] = plot
        lines = [*lines, str(plot)]
    return Answer(data, "\n".join(lines))


def read_definition(name: str) -> ast.FunctionDef:
    """Return the signature and the docstring of a function of `rig_sim`, with the choices that its module names."""
    path = Path(__file__).parents[2].joinpath(*HOMES[name].split(".")).with_suffix(".py")
    source = path.read_text(encoding="utf-8")
    head = re.findall(rf'^def {name}\(.*?^    """$', source, re.MULTILINE | re.DOTALL)[0]
    for alias, choices in CHOICES.findall(source):
        head = head.replace(f": {alias} =", f": {choices} =")
    return next(node for node in ast.parse(head).body if isinstance(node, ast.FunctionDef))


def read_help(definition: ast.FunctionDef) -> tuple[str, dict[str, str]]:
    """Return a docstring's text before its sections, and that of each parameter, as a command line shows them."""
    words, _, sections = (ast.get_docstring(definition) or "").partition("\n\nParameters\n----------\n")
    entries = ENTRY.findall(sections.partition("\n\n")[0] + "\n")
    helps = {name: IN_PYTHON.sub("", " ".join(text.split())) for name, text in entries}

    def spell(text: str) -> str:
        return re.sub(r"``?([^`]*)``?", lambda code: f"--{code[1]}" if code[1] in helps else code[1], text)

    return spell(COMMAND_NAME.sub("", words)), {name: spell(text) for name, text in helps.items()}


def read_parameters(definition: ast.FunctionDef, helps: dict[str, str], required: str) -> Iterator[inspect.Parameter]:
    """Yield the parameters of a command: the scene by position, all others by flags; ``required`` has no default."""
    arguments, absent = definition.args, inspect.Parameter.empty
    positional, keywords = arguments.args, arguments.kwonlyargs
    defaults = [None] * (len(positional) - len(arguments.defaults)) + arguments.defaults + arguments.kw_defaults
    for argument, default in zip([*positional, *keywords], defaults, strict=True):
        name = argument.arg
        if name == "progress":
            continue
        kind = inspect.Parameter.POSITIONAL_ONLY if name == "scene" else inspect.Parameter.KEYWORD_ONLY
        value = absent if default is None or name == required else ast.literal_eval(default)
        flag = choose_flag(name, argument.annotation, helps[name])
        yield inspect.Parameter(name, kind, default=value, annotation=flag)


def choose_flag(name: str, annotation: ast.expr | None, text: str) -> Any:
    """Return the type of a flag with its help: a number that may have a unit stays as typed."""
    stated = ast.unparse(annotation or ast.Constant("")).strip("'")
    kinds = {kind.strip() for kind in stated.split("|")}
    flag = "--" + name.replace("_", "-")
    if name == "scene":
        return Annotated[str, Parameter(help=text)]
    if stated.startswith("Literal"):
        choices: Any = Literal[tuple(ast.literal_eval(stated.removeprefix("Literal")))]
        return Annotated[choices, Parameter(help=text)]
    if {"float", "str"} <= kinds:
        return Annotated[float | str | None, flags.word(flag, text)]
    if "Sequence[float]" in kinds:
        numbers = Parameter(converter=read_numbers, allow_leading_hyphen=True, negative=(), help=text)
        return Annotated[list[float] | float | None, numbers]
    if "Path" in kinds:
        return Annotated[Path | None, Parameter(name=[flag, "-o"] if name == "output" else flag, help=text)]
    if "bool" in kinds:
        return Annotated[bool, Parameter(negative=(), help=text)]
    if "int" in kinds:
        return Annotated[int | None, application.Whole, Parameter(help=text)]
    return Annotated[(float if "float" in kinds else str) | None, Parameter(help=text)]


def read_numbers(type_: Any, tokens: Sequence[Token]) -> float | list[float]:
    """Return the number of a flag, or the numbers where it is a list; a cyclopts converter."""
    texts = [token.value for token in tokens]
    parts = [part for text in texts for part in text.strip("[] ").split(",")]
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        problem = f"{','.join(texts)!r} contains something that is not a number"
        raise InputError(problem, tokens[0].keyword or "", "write 0.1,0.2") from None
    return numbers if len(parts) > 1 or "[" in texts[0] else numbers[0]
