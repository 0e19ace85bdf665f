"""The command `dashpot`: finds the command asked for, runs it, and turns what goes wrong into lines and exit codes.

0 done; 2 bad usage, model or data; 3 not identifiable or not converged; 4 does not fit, where that is asked;
5 not enough memory; 1 internal error; 130 interrupted.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from dashpot.app.commands import COMMANDS, GROUPS, OTHER
from dashpot.app.process import (
    CURE,
    EXIT_CODE,
    Ended,
    NotEnoughMemoryError,
    answered,
    end_on_signals,
    lacked,
    leave_signals,
    memory_is_limited,
    one_thread,
    request_lost,
    secure_room,
    tell,
)
from dashpot.app.report_files import ARGUMENTS
from dashpot.errors import DashpotError, printable
from dashpot.io import ledger

FAULT, USAGE, INTERRUPTED, BROKEN_PIPE = 1, 2, 130, 141  # 128 + signal, as shells report it
TRACEBACK = "DASHPOT_TRACEBACK"
COMPLETION = "_DASHPOT_COMPLETE"  # set by the script that `dashpot completion` prints


@contextmanager
def resumable(ctx: click.Context, kept: str) -> Iterator[None]:
    """A run that ends early says what is `kept`, from which the same command goes on."""
    try:
        yield
    except (KeyboardInterrupt, Ended) as cause:
        answered()
        tell(f"dashpot: interrupted; {kept}: run it again to continue")
        ctx.exit(128 + cause.number if isinstance(cause, Ended) else INTERRUPTED)


class Commands(click.Group):
    """Commands by name, each imported when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of COMMANDS."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The click command of that name; None if there is none."""
        if cmd_name not in COMMANDS:
            return None
        command = import_module(f"dashpot.app.commands.{cmd_name}").command
        assert isinstance(command, click.Command)
        return command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click does, with the help where nothing is typed; reports name the command by what was typed."""
        ctx.meta[ARGUMENTS] = tuple(args)
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help())
            ctx.exit(USAGE)
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does, with the nearest name in the message where there is no such command."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            from difflib import get_close_matches

            near = get_close_matches(args[0], COMMANDS, n=1)
            cure = f"did you mean {near[0]}?" if near else f"the commands are {', '.join(COMMANDS)}"
            raise click.UsageError(f"there is no command {args[0]!r}; {cure}", ctx)
        secure_room()
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of commands, without importing them."""
        width = max(map(len, COMMANDS))
        headings = {name: title for title, commands in GROUPS for name in commands}
        groups: dict[str, list[tuple[str, str]]] = {}
        for name, text in COMMANDS.items():
            groups.setdefault(headings.get(name, OTHER), []).append((name.ljust(width), text))
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Where to go on."""
        formatter.write_paragraph()
        formatter.write("dashpot COMMAND --help explains a command, with examples.\n")

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names of commands, without importing them; after a -, options."""
        if incomplete.startswith("-"):
            return click.Command.shell_complete(self, ctx, incomplete)
        return [
            CompletionItem(name, help=text) for name, text in COMMANDS.items() if name.startswith(incomplete)
        ]


def _version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        from dashpot import __version__

        click.echo(f"dashpot {__version__}")
        ctx.exit()


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_version,
    help="Show the version and exit.",
)
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Identify the masses, dampers and springs of a vibrating rig from noisy test data, with confidence intervals."""
    ctx.with_resource(ledger.opened())


def run(args: Sequence[str] | None = None) -> int:
    """Run one command line (that of the process unless given); the exit code.

    What goes wrong is reported on stderr, one line for each problem.  With DASHPOT_TRACEBACK set, internal errors are
    raised instead.
    """
    if os.environ.get(COMPLETION):  # the shell asks how to go on from what is typed
        from click.shell_completion import shell_complete

        return shell_complete(cli, {}, "dashpot", COMPLETION, os.environ[COMPLETION])
    try:
        result = cli.main(None if args is None else list(args), prog_name="dashpot", standalone_mode=False)
        sys.stdout.flush()
    except (Ended, KeyboardInterrupt, click.Abort) as asked:
        return _stopped(asked)
    except (BrokenPipeError, SystemExit):
        # Whoever read the output has had enough (| head): click and rich answer that with SystemExit, and nothing
        # else here does.  What is still buffered must not complain at exit.
        _silence_stdout()
        return BROKEN_PIPE
    except Exception as error:
        if not isinstance(error, click.ClickException | DashpotError):
            # The request to end that an error was raised from. One that comes while a module makes a class is
            # wrapped in a RuntimeError by Python 3.11, and libraries may do alike
            behind = error.__cause__ or error.__context__
            while behind is not None and not isinstance(behind, Ended | KeyboardInterrupt):
                behind = behind.__cause__ or behind.__context__
            asked_by = behind or request_lost()
            if asked_by is not None:
                return _stopped(asked_by)
            if os.environ.get(TRACEBACK) and not lacked(error):
                raise
        lines, code = account(error)
        _tell(lines)
        return code
    return result if isinstance(result, int) else 0


def _stopped(asked: BaseException) -> int:
    """What a run that was asked to end says, and the exit code that shells expect of it."""
    answered()
    if isinstance(asked, Ended) and asked.number != signal.SIGINT:
        _tell([f"ended by {signal.Signals(asked.number).name}; no file is left half-written"])
        return 128 + asked.number
    _tell(["interrupted; no file is left half-written"])
    return INTERRUPTED


def account(error: Exception) -> tuple[list[str], int]:
    """What is said of an error, one line for each problem, and the exit code.

    What the system refuses is the user's to mend; anything else that nobody foresaw is a fault of the program.
    """
    if isinstance(error, click.ClickException):
        text = " ".join(error.format_message().split()).rstrip(".")
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else "dashpot"
        # A cure follows a semicolon; where the message has none, the command's own help is it.
        return [f"{text} (see {path} --help)" if "; " in text else f"{text}; see {path} --help"], USAGE
    if (memory_is_limited() or not isinstance(error, DashpotError)) and lacked(error):
        # It blames no file: what a lack of memory stops first is no more than the next in line.
        short = str(error) if isinstance(error, NotEnoughMemoryError) else f"not enough memory: {CURE}"
        return [short], EXIT_CODE
    if isinstance(error, DashpotError):
        most = 20  # a screenful is told one by one
        lines = [str(problem) for problem in error.problems[:most]]
        if len(error.problems) > most:
            lines.append(f"{len(error.problems) - most} more problems; correct these first")
        return lines, error.exit_code
    if isinstance(error, OSError):
        place = "standard output" if error.filename is None else str(error.filename)
        _silence_stdout()
        reason = f"{place}: cannot be used ({error.strerror or error}); check the path and the space left"
        return [reason], USAGE
    cause = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    return [f"internal error, please report ({cause}); {TRACEBACK}=1 shows where"], FAULT


def _silence_stdout() -> None:
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError, AttributeError):  # stdout is not a file
        return


def _tell(lines: Iterable[str]) -> None:
    for line in lines:
        with suppress(OSError):  # nobody listens: the exit code says it all the same
            tell(f"dashpot: {printable(line)}")


def main() -> None:
    """Entry point of the command `dashpot`."""
    try:
        # Standard streams that the caller has closed lead nowhere, rather than into the first file that is
        # opened. What is written to stdout then fails, as it does on a full disk.
        for number in range(3):
            try:
                os.fstat(number)
            except OSError:
                # Takes the lowest number that is free
                os.open(os.devnull, os.O_RDONLY if number == 1 else os.O_RDWR)
        for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
            if getattr(sys, name) is None:
                setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
        end_on_signals()
        for stream in (sys.stdout, sys.stderr):
            # A terminal that knows no ± or χ² shows ? rather than ending the run.
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="replace")
        # The size of a terminal, or none: rich takes digits of any script and number.
        for name in ("COLUMNS", "LINES"):
            given = os.environ.get(name, "")
            if not (given.isascii() and given.isdecimal() and len(given) < 10 and int(given)):
                os.environ.pop(name, None)
        for name in ("MPLBACKEND", "SOURCE_DATE_EPOCH"):  # figures have no window and say no date
            os.environ.pop(name, None)
        one_thread()
        if not os.environ.get(TRACEBACK) and not sys.warnoptions:
            # What matters is in the results; warnings of the interpreter and of libraries are for developers.
            warnings.simplefilter("ignore")
        code = run()
        leave_signals()
    except (Ended, KeyboardInterrupt) as asked:  # in the moments before the run and after it
        leave_signals()
        code = _stopped(asked)
    # Whether this process was started for the command, by its script or `python -m`, not by a program that goes on
    started = sys.modules["__main__"]
    spec, file = getattr(started, "__spec__", None), getattr(started, "__file__", None) or ""
    if not (spec.name == "dashpot.__main__" if spec is not None else Path(file).stem == "dashpot"):
        sys.exit(code)
    # All is unwound and told.  Were the interpreter taken down now, threads of libraries that still work (those that
    # read ahead) might ask for it once more: they would be ended within C++, and the process with them, by SIGABRT.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
