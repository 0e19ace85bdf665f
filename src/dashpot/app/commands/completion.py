"""dashpot completion: the script that lets a shell complete commands, options and their values."""

from __future__ import annotations

from typing import Annotated

import click

from dashpot.app.options import Option, dashpot_command


@dashpot_command(
    'eval "$(dashpot completion bash)"        # in ~/.bashrc',
    'eval "$(dashpot completion zsh)"         # in ~/.zshrc',
    "dashpot completion fish > ~/.config/fish/completions/dashpot.fish",
)
def command(shell: Annotated[str, Option("", click.Choice(["bash", "zsh", "fish"])), "Which shell."]) -> None:
    """Print the completion script for SHELL: bash (4.4 or newer), zsh or fish."""
    from click.shell_completion import get_completion_class

    from dashpot.app.cli import COMPLETION, cli

    kind = get_completion_class(shell)
    assert kind is not None
    complete = kind(cli, {}, "dashpot", COMPLETION)
    click.echo(complete.source_template % complete.source_vars())
