"""Functions as commands: options by their signature, words by their docstring."""

import contextlib
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer

from ttus_opt.cli import command as command_module
from ttus_opt.cli.app import app
from ttus_opt.cli.command import add_command
from ttus_opt.cli.console import to_machine
from ttus_opt.haptic.field_wrench import FORCE_LIMIT, TORQUE_LIMIT
from ttus_opt.message.field_message import MOST_VOXELS


@dataclass(frozen=True)
class Tide:
    """A group.

    Attributes:
        height: Of the water
            in metres.
        wind: Speed.
    """

    height: float = 1.5
    wind: Annotated[float, typer.Option(metavar="KNOTS")] = 0.0


def own_command(tide: Tide, file: Path, deep: bool = False) -> None:
    """Say it.

    Args:
        file: Where: here or there.
        deep: Dive.

    Example:
        own-command --file
        a.txt
    """
    typer.echo(f"{tide.height} {file.name} {deep} {to_machine()}")


#: Words of typer's own, of two options
SHARED = typer.Option(metavar="NUMBER")


def second_command(
    context: typer.Context,
    output: Path,
    near_by: Annotated[float, SHARED] = 1.0,
    far: Annotated[float, SHARED] = 2.0,
    very_far: bool = False,
    force: bool = False,
) -> None:
    """Say more.

    Args:
        output: Where to.
        near_by: Close.
        far: Away.
        very_far: Out of sight.
        force: With all might.

    Example:
        second-command
    """
    typer.echo(f"{context.info_name} {output.name} {near_by} {very_far} {force}")


def test_typer_s_own_words_stay_and_each_option_has_its_own_help(capsys):
    made = typer.Typer(add_completion=False, rich_markup_mode=None)
    add_command(made, second_command)
    command = typer.main.get_command(made)
    assert command.name == "second-command"
    options = {option.name: option for option in command.params}
    assert [options[n].help for n in ("near_by", "far")] == ["Close.", "Away."]
    assert {options[n].metavar for n in ("near_by", "far")} == {"NUMBER"}
    assert options["output"].opts == ["-o", "--output"]
    assert options["very_far"].opts == ["--very-far"]
    assert options["force"].help == "With all might."  # not as in other commands
    assert SHARED.help is None
    words = ["-o", "x/b.txt", "--near-by", "3", "--very-far"]
    command(words, prog_name="here", standalone_mode=False)
    assert capsys.readouterr().out == "here b.txt 3.0 True False\n"


@pytest.fixture
def small():
    made = typer.Typer(add_completion=False, rich_markup_mode=None)
    add_command(made, own_command)
    return typer.main.get_command(made)


def test_a_group_stands_in_its_parameters_place(small, capsys):
    small(["--height", "2", "--file", "x/a.txt", "--deep"], standalone_mode=False)
    assert capsys.readouterr().out == "2.0 a.txt True False\n"


def test_words_are_those_of_the_docstring(small):
    words = {option.name: option.help for option in small.params}
    assert words["height"] == "Of the water in metres."
    metavars = {option.name: option.metavar for option in small.params}
    assert (words["wind"], metavars["wind"]) == ("Speed.", "KNOTS")
    assert words["file"] == "Where: here or there."
    assert words["json"] == "Print JSON on stdout, for other programs."
    assert small.help == "Say it."
    assert small.epilog == "Example: own-command --file a.txt"
    (deep,) = (option for option in small.params if option.name == "deep")
    assert deep.opts == ["--deep"] and not deep.secondary_opts


def commands(group: Any) -> list[Any]:
    own = group.commands.values()
    return [
        c
        for each in own
        for c in (commands(each) if hasattr(each, "commands") else [each])
    ]


def test_every_option_says_what_it_does_and_every_command_has_an_example():
    found = commands(typer.main.get_command(app))
    assert len(found) > 20
    for command in found:
        assert "ttus-opt" in command.epilog
        silent = [p.name for p in command.params if not (p.help or p.hidden)]
        assert not silent, (command.name, silent)


def test_every_example_is_one_that_the_command_takes():
    root = typer.main.get_command(app)
    for command in commands(root):
        words, named = shlex.split(command.epilog), root
        del words[: words.index("ttus-opt") + 1]
        while hasattr(named, "commands"):
            named = named.commands[words.pop(0)]
        assert named is command
        with command.make_context(command.name, words):
            pass


def test_limits_are_the_library_s():
    """A number in a signature, so that help does not load the library."""
    commands = typer.main.get_command(app).commands
    for name, option, expected in (
        ("render", "force_limit", FORCE_LIMIT),
        ("render", "torque_limit", TORQUE_LIMIT),
        ("decode", "max_voxels", MOST_VOXELS),
    ):
        (own,) = (o for o in commands[name].params if o.name == option)
        assert own.default == expected


def typed_names(group=None, names=()):
    """Every command of the program, in groups too, as it is typed."""
    group = group or typer.main.get_command(app)
    for name, found in group.commands.items():
        if hasattr(found, "commands"):
            yield from typed_names(found, (*names, name))
        else:
            yield " ".join((*names, name))


@pytest.mark.parametrize("name", list(typed_names()))
def test_every_command_takes_short_help_a_log_and_quiet(run, name):
    answer = run(f"{name} -h")
    assert answer.status == 0 and answer.out.startswith(f"Usage: ttus-opt {name} ")
    for option in ("-v, --verbose", "-q, --quiet", "-h, --help"):
        assert option in answer.out
    assert max(map(len, answer.out.splitlines())) <= 80


@pytest.mark.parametrize(
    ("words", "heard"),
    [
        ("-v solvers", (1, False)),
        ("solvers -v", (1, False)),
        ("-qv solvers -v", (2, True)),
        ("formulations -q", (0, True)),
    ],
)
def test_a_log_and_quiet_are_taken_before_a_command_too(run, monkeypatch, words, heard):
    got = []

    def listen(verbose, *, quiet, json):
        return contextlib.nullcontext(got.append((verbose, quiet)))

    monkeypatch.setattr(command_module, "speaking", listen)
    assert run(words).status == 0
    assert got == [heard]


def test_all_that_is_missing_is_named_at_once(run):
    told = run("fit --probe sphere:0.02")
    assert told.status == 2
    assert told.errors == [
        "error: missing: --surface, --trajectory, -o/--output: see ttus-opt fit --help"
    ]
    said = run("synchronise -o a.csv").errors
    assert said[0].startswith("error: missing: poses, --wrenches: see ")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_shown(run, monkeypatch, shell):
    monkeypatch.setattr("shellingham.detect_shell", lambda: (shell, shell))
    monkeypatch.delenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", raising=False)
    assert "_TTUS_OPT_COMPLETE" in run("--show-completion").out
