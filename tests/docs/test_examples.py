"""The examples of the documentation: commands that exist, output as shown, links that lead somewhere."""

import doctest
import re
import shlex
import shutil

import pytest

from . import examples
from .examples import APPLICATIONS

TEXTS = {page.relative_to(examples.ROOT).as_posix(): page.read_text() for page in examples.PAGES}


def typed_in(texts):
    """Return the commands of pages, each with page and line of its block for a name."""
    return [
        pytest.param(command.typed, id=f"{name}:{block.line}")
        for name, text in texts.items()
        for block in examples.blocks(name, text, "console", "")
        for command in examples.commands(block)
    ]


TYPED = typed_in(TEXTS)
TRIED = {
    name: examples.blocks(name, text, "console", "python", "pycon")
    for name, text in TEXTS.items()
    if name.startswith(("docs/tutorial", "docs/how-to", "docs/explanation", "docs/reference"))
}
NOT_RUN = [block for found in TRIED.values() for block in found if block.reason]
RUN = {name: [block for block in found if not block.reason] for name, found in TRIED.items()}


def test_the_pages_were_read():
    assert len(TYPED) > 80
    assert len(TRIED) > 10


@pytest.mark.parametrize("typed", TYPED)
def test_every_command_and_flag_of_the_pages_exists(typed):
    parse(typed)


def test_every_command_and_flag_of_the_help_pages_exists():
    """In one test: the pages are made from the commands, which takes 2 s in every process that collects tests."""
    found = typed_in(examples.help_pages())
    assert len(found) > 20
    for command in found:
        parse(*command.values)


def parse(typed):
    """Let the applications parse the commands of a line, each of which must exist with its flags."""
    for part in re.split(r'(?: && |; | \| )(?=(?:[^"]*"[^"]*")*[^"]*$)', typed):
        words = shlex.split(part, comments=True)
        names = [word for word in words if word.rpartition("/")[2] in APPLICATIONS]
        if not names:
            continue
        arguments = words[words.index(names[0]) + 1 :]
        arguments = arguments[: next((i for i, word in enumerate(arguments) if word in (">", "&")), None)]
        APPLICATIONS[names[0].rpartition("/")[2]].parse_args(arguments, exit_on_error=False, print_error=False)


@pytest.mark.parametrize("page", examples.PAGES, ids=lambda page: page.stem)
def test_every_link_and_picture_leads_to_a_file(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    targets = re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", text)
    assert [target for target in targets if "://" not in target and not (page.parent / target).exists()] == []


@pytest.mark.parametrize("block", NOT_RUN, ids=lambda block: f"{block.page}:{block.line}")
def test_an_example_that_is_not_run_says_why(block):
    pytest.skip(block.reason)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, found in RUN.items() if found])
def test_the_examples_do_what_the_page_says(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(examples.ROOT / "data_samples", "data_samples")
    names: dict[str, object] = {}
    for block in RUN[name]:
        if block.kind == "console":
            for command in examples.commands(block):
                examples.run(command, tmp_path)
        elif block.kind == "python":
            exec(compile(block.text, name, "exec"), names)
        else:
            test = doctest.DocTestParser().get_doctest(block.text, names, name, name, block.line)
            runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
            said: list[str] = []
            assert not runner.run(test, out=said.append, clear_globs=False).failed, "".join(said)
            names = test.globs
