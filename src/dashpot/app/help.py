"""Commands whose --help shows options in groups, in the order they are declared, and examples."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import click

Function = TypeVar("Function", bound=Callable[..., Any])
GENERAL = "General"
WIDEST = 100  # columns of help text


class GroupedOption(click.Option):
    """An option that stands under the heading `group` in --help; without a value it means `alone`, if that is given."""

    def __init__(self, *args: Any, group: str = GENERAL, alone: str | None = None, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.group = group
        self.alone = alone


class GroupedCommand(click.Command):
    """A command with `examples`, printed below its options."""

    def __init__(self, *args: Any, examples: Sequence[str] = (), **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self.examples = tuple(examples)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click does; an option whose value may be left out takes the next word only if it is such a value."""
        for parameter in self.get_params(ctx):
            if isinstance(parameter, GroupedOption) and parameter.alone is not None:
                following = [*args[1:], ""]
                args = [_complete(parameter, ctx, word, following[k]) for k, word in enumerate(args)]
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            error.ctx = error.ctx or ctx  # click names none where a value is missing
            raise

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Options by group: in the order of their first option, the general ones last."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx) if isinstance(parameter, click.Option) else None
            if record is not None:
                groups.setdefault(getattr(parameter, "group", GENERAL), []).append(record)
        groups[GENERAL] = groups.pop(GENERAL, [])
        for title, records in groups.items():
            with formatter.section(title):
                formatter.write_dl(records)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Examples; a long one goes on in the next line as a shell reads it, for they are to be copied."""
        if self.examples:
            with formatter.section("Examples"):
                indent = " " * formatter.current_indent
                for example in self.examples:
                    formatter.write(
                        indent + _folded(example, formatter.width - 2 * len(indent), indent) + "\n"
                    )


def _folded(example: str, width: int, indent: str) -> str:
    """The command in lines of at most `width`, broken before an option."""
    lines = [""]
    for part in re.split(r" (?=-)", example):
        if lines[-1] and len(lines[-1]) + len(part) + 3 > width:
            lines.append(part)
        else:
            lines[-1] = f"{lines[-1]} {part}".strip()
    return f" \\\n{indent}    ".join(lines)


def _complete(option: GroupedOption, ctx: click.Context, word: str, following: str) -> str:
    """The option with its value where it stands alone; every other word as it is."""
    if word not in option.opts:
        return word
    try:
        option.type.convert(following, option, ctx)
    except click.UsageError:
        return f"{word}={option.alone}"
    return word


def dashpot_command(name: str, *examples: str) -> Callable[[Callable[..., Any]], GroupedCommand]:
    """Decorator: a GroupedCommand of that name."""
    return click.command(name, cls=GroupedCommand, examples=examples)


def option(*declarations: str, group: str = GENERAL, **attributes: Any) -> Callable[[Function], Function]:
    """Decorator: an option under the heading `group`."""
    return click.option(*declarations, cls=GroupedOption, group=group, **attributes)
