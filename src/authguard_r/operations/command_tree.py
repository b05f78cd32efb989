# SPDX-License-Identifier: Apache-2.0
"""A program's commands as a tree: help lists them from a table, and a call imports one of them.

Spec page: docs/reference/cli.md
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from authguard_r.wire.output import shows_color

#: How the variables of defaults begin.
PREFIX = "AUTHGUARD_"
#: Longest help of a command in a list, in characters: it fits a terminal of 80 columns.
LINE = 58


class CommandEntry(NamedTuple):
    """One command.

    Args:
        place: `module:name`, below the program's package; the function is `name_command`.
        help: its line in a list of commands, at most `LINE` characters.
    """

    place: str
    help: str


class Program(NamedTuple):
    """A program's commands.

    Args:
        name: the program.
        package: where its modules are.
        distribution: whose version it has.
        help: what it is for.
        commands: each command by its words, `keys init`.
        groups: what each group is about, by its words.
        sections: who uses which commands: headings of the first list, with first words.
        services: commands that take no defaults: what a process serves is named where it starts.
        renamed: old words of commands and groups, with the words that they have now.
        renamed_options: the same of options, by the words of their command or group.
    """

    name: str
    package: str
    distribution: str
    help: str
    commands: Mapping[str, CommandEntry]
    groups: Mapping[str, str]
    sections: Mapping[str, tuple[str, ...]]
    services: frozenset[str] = frozenset()
    renamed: Mapping[str, str] = {}
    renamed_options: Mapping[str, Mapping[str, str]] = {}


class Commands(Mapping[str, Any]):
    """The commands of a group by name; each is imported when it is looked up.

    Args:
        program: the program.
        above: the group's words.
    """

    def __init__(self, program: Program, above: tuple[str, ...] = ()) -> None:
        self.program = program
        self._above = above
        self._found: dict[str, TyperCommand | TyperGroup] = {}
        known = [line.split() for line in program.commands]
        size = len(above)
        self._names = [*dict.fromkeys(w[size] for w in known if tuple(w[:size]) == above)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __getitem__(self, name: str) -> TyperCommand | TyperGroup:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._found:
            words = (*self._above, name)
            entry = self.program.commands.get(" ".join(words))
            if entry is None:
                below: Any = Commands(self.program, words)
                told = self.program.groups[" ".join(words)]
                self._found[name] = CommandGroup(name=name, help=told, commands=below, **_PLAIN)
            else:
                made = self._found[name] = _leaf(f"{self.program.package}.{entry.place}", name)
                if " ".join(words) in self.program.services:
                    for parameter in made.params:
                        parameter.envvar = None
        return self._found[name]

    def help(self, name: str) -> str:
        """Return the line of a command or group in a list; nothing is imported."""
        words = " ".join((*self._above, name))
        entry = self.program.commands.get(words)
        return self.program.groups[words] if entry is None else entry.help

    def sections(self) -> Iterator[tuple[str, list[tuple[str, str]]]]:
        """Yield each heading of the list, with its commands and their lines."""
        if self._above:
            yield "Commands", [(name, self.help(name)) for name in self]
            return
        for heading, names in self.program.sections.items():
            yield heading, [(name, self.help(name)) for name in names]


class CommandGroup(TyperGroup):
    """A group of commands; called without arguments it prints its help."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments; without any, print the help."""
        args = args if args or ctx.resilient_parsing else ["-h"]
        # a group before a command parses nothing
        self.add_help_option = not args or args[0].startswith("-")
        print_help(ctx, args)
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands, then the options."""
        commands: Any = self.commands
        for heading, rows in commands.sections():
            with formatter.section(heading):
                formatter.write_dl(rows)
        TyperCommand.format_options(self, ctx, formatter)  # type: ignore[arg-type]

    def get_help(self, ctx: Any) -> str:
        """Return the help, with colors on a terminal."""
        return colored(super().get_help(ctx))


class ProgramCommand(TyperCommand):
    """A command; options with a variable have a default in `authguard.toml`, too."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments, with the defaults of options that were not named.

        Before a command signs, it prints where the trust root and the key come from.
        """
        print_help(ctx, args)
        named = {str(p.name): _default_name(p) for p in self.params if _default_name(p)}
        if not named or ctx.resilient_parsing:
            return self._parsed(ctx, args)
        from authguard_r.operations.defaults import working_defaults

        found = working_defaults()
        if found.ignored:
            typer.echo(found.ignored, err=True)
        ctx.default_map = {k: found.values[v] for k, v in named.items() if v in found.values}
        rest = self._parsed(ctx, args)
        origin = {"ENVIRONMENT": "the environment", "DEFAULT_MAP": str(found.path)}
        of = {name: origin.get(ctx.get_parameter_source(name).name, "") for name in named}
        if ctx.params.get("store") is not None and of.get("gate"):
            ctx.params["gate"] = None  # the user named a store, and no gate
        for name in ("trust", "key") if "key" in named else ():
            if of.get(name):
                typer.echo(f"{name}: {ctx.params[name]} (from {of[name]})", err=True)
        if "key" in named and ctx.params["key"] is None and not ctx.params.get("as_json"):
            typer.echo("key: the one in the demonstration's trust folder", err=True)
        return rest

    def _parsed(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments; one that is missing names the others that are.

        Raises:
            TyperException: wrong usage.
        """
        given = list(args)
        try:
            return super().parse_args(ctx, args)
        except TyperException as error:
            first = getattr(error, "param", None)
            if type(error).__name__ == "MissingParameter" and first is not None:
                more = [p.opts[0] for p in self.params if _is_missing(p, ctx, given)]
                others = ", ".join(name for name in more if name not in first.opts)
                error.message = f"Also missing: {others}" if others else ""
            raise

    def get_help(self, ctx: Any) -> str:
        """Return the help, with colors on a terminal."""
        return colored(super().get_help(ctx))


def _is_missing(option: Any, ctx: Any, args: list[str]) -> bool:
    """Return whether a required option is neither in the arguments nor has a default."""
    if not option.required or not option.opts[0].startswith("-"):
        return False
    named = {argument.partition("=")[0] for argument in args}
    default = (ctx.default_map or {}).get(option.name)
    return named.isdisjoint(option.opts) and not default and not os.environ.get(option.envvar or "")


def with_new_names(program: Program, arguments: list[str]) -> tuple[list[str], list[str]]:
    """Return a command line in the names of this version.

    Old names of commands and options work for one version.

    Returns:
        The arguments, and a hint for each old name in them.
    """
    hints: list[str] = []
    for old, new in program.renamed.items():
        size = len(old.split())
        if arguments[:size] == old.split():
            arguments = [*new.split(), *arguments[size:]]
            hints.append(f"`{program.name} {old}` is now `{program.name} {new}`")
    for command, options in program.renamed_options.items():
        if arguments[: len(command.split())] != command.split():
            continue
        for place, argument in enumerate(arguments):
            old, equals, value = argument.partition("=")
            if new := options.get(old, ""):
                arguments = [*arguments[:place], f"{new}{equals}{value}", *arguments[place + 1 :]]
                hints.append(f"`{old}` is now `{new}`")
    return arguments, [f"{hint}; the old name ends with the next version" for hint in hints]


def print_help(ctx: Any, args: list[str]) -> None:
    """Print a command's help where the arguments begin with it; no parser is needed for that."""
    if args and args[0] in ctx.help_option_names and not ctx.resilient_parsing:
        typer.echo(ctx.get_help())
        ctx.exit()


def _default_name(option: Any) -> str:
    """Return the name of an option's default; empty: it has none."""
    return str(getattr(option, "envvar", None) or "").removeprefix(PREFIX).lower()


def colored(text: str) -> str:
    """Return a help text with headings and names in color, where standard output shows colors."""
    if not shows_color(sys.stdout):
        return text
    text = re.sub(r"(?m)^(\S[^\n]*:|Usage:)", lambda m: typer.style(m[0], bold=True), text)
    return re.sub(r"(?m)^  \S(?:[^\n]*?\S)?(?=  )", lambda m: typer.style(m[0], fg="cyan"), text)


def command_tree(program: Program, first: str = "") -> TyperGroup:
    """Return a program's commands, to be called or looked through.

    Args:
        program: the program.
        first: the first word of the command line. A command there leaves out the options of the
            program itself, whose parser takes longer to import than most commands.
    """
    is_command = bool(first) and not first.startswith("-")
    app = typer.Typer(
        name=program.name,
        help=program.help,
        cls=CommandGroup,
        context_settings={"help_option_names": ["-h", "--help"]},
        add_completion=not is_command,
        **_PLAIN,
    )
    app.callback()((lambda: None) if is_command else _top)
    made: Any = typer.main.get_command(app)
    made.commands = Commands(program)
    return made  # type: ignore[no-any-return]


def _version(ctx: typer.Context, asked: bool) -> None:  # noqa: FBT001 - typer calls it so
    """Print the program's version and end."""
    if asked:
        from importlib.metadata import version

        command: Any = ctx.command
        program: Program = command.commands.program
        typer.echo(f"{program.name} {version(program.distribution)}")
        raise typer.Exit


def _top(
    _asked: Annotated[  # noqa: FBT002 - as above
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Take the options of the program itself."""


@cache
def _leaf(place: str, name: str) -> TyperCommand:
    """Return one command: its function is imported here."""
    module, _, function = place.partition(":")
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, **_PLAIN)
    app.command(name, cls=ProgramCommand)(getattr(import_module(module), f"{function}_command"))
    made: Any = typer.main.get_command(app)
    return made  # type: ignore[no-any-return]


#: No boxes around help: it is read by screen readers, in logs and in the reference, too.
_PLAIN: Any = {"rich_markup_mode": None}
