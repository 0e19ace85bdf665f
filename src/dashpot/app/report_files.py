"""Reports as files: how a result was computed, and HTML or PDF."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from dashpot.app.options import OUTPUT, OutputFile, option
from dashpot.errors import UsageError
from dashpot.io.words import REPORTS, chosen_format

if TYPE_CHECKING:
    from dashpot.present.pages.page import Provenance

ARGUMENTS = "dashpot.arguments"  # what was typed, in the context's meta
LABELS = "dashpot.labels"  # lines of the first page, there too
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-pdf-header-footer",
)  # fmt: skip
PRINTING_S = 120.0

Function = TypeVar("Function", bound=Callable[..., Any])


def _kept(context: click.Context, _: click.Parameter, labels: tuple[str, ...]) -> None:
    """Keep the lines for the report's first page.  Raises UsageError where there is no report."""
    if labels and context.params.get("report") is None:
        raise click.UsageError("--label is a line of the report: give --report FILE.html as well", context)
    context.meta[LABELS] = tuple(line for label in labels if (line := " ".join(label.split())))


def report_option(function: Function) -> Function:
    """Decorator: --report as the parameter `report`, and --label, which `provenance` takes.

    A browser for PDF is looked for once all parameters have been checked, before the work.
    """

    @wraps(function)
    def with_browser(*args: Any, **parameters: Any) -> Any:
        if parameters["report"] is not None and is_pdf(parameters["report"]):
            browser()
        return function(*args, **parameters)

    label = option(
        "--label", multiple=True, metavar="TEXT", group=OUTPUT, expose_value=False, callback=_kept,
        help="Print a line at the head of the report, such as 'Client: A. Smith'; may be repeated.",
    )  # fmt: skip
    report = option(
        "--report", type=OutputFile(formats=REPORTS), metavar="FILE.html|pdf", group=OUTPUT, is_eager=True,
        help="Write a report with figures as one HTML file, or as PDF (needs Chromium or Chrome).",
    )  # fmt: skip
    return report(label(cast(Function, with_browser)))


def is_pdf(target: str) -> bool:
    """Whether a report of that name is to be a PDF file."""
    return chosen_format(target, REPORTS) == "pdf"


def browser() -> str:
    """The program that prints PDF.  Raises UsageError where there is none."""
    import shutil

    for name in BROWSERS:
        path = shutil.which(name)
        if path is not None:
            return path
    raise UsageError(
        "a PDF report is printed by Chromium or Chrome, and neither is installed",
        "--report",
        "install one, or name the report .html and print that",
    )


def write_report(target: str, html: str) -> None:
    """Write the page as HTML or, by the end of the name, as PDF.  Raises DataError."""
    from dashpot.io.atomic import write_bytes, write_text

    if is_pdf(target):
        write_bytes(target, _printed(html))
    else:
        write_text(target, html)


@contextmanager
def failure_reported(target: str | None, rig: str) -> Iterator[None]:
    """Where the work inside gives no answer, the report says so, with the rig, before the error goes on."""
    from dashpot.errors import ConvergenceError, IdentifiabilityError

    try:
        yield
    except (IdentifiabilityError, ConvergenceError) as error:
        if target is not None:
            from dashpot.model.rigfile import read_rig
            from dashpot.present.pages.report import failure_report

            read = read_rig(rig)
            write_report(target, failure_report(read.model, read.channels, error, provenance()))
        raise


def _printed(html: str) -> bytes:
    """The page as PDF."""
    import subprocess

    from dashpot.errors import DataError
    from dashpot.io.atomic import scratch

    with scratch() as files:
        page = files.write("report.html", html.encode("utf-8", errors="backslashreplace"))
        command = [
            browser(),
            *QUIET,
            f"--user-data-dir={files.folder / 'profile'}",
            f"--print-to-pdf={files.folder / 'report.pdf'}",
            page.as_uri(),
        ]
        try:
            subprocess.run(command, capture_output=True, timeout=PRINTING_S, check=True)
            return files.read("report.pdf")
        except (OSError, subprocess.SubprocessError) as error:
            raise DataError(
                f"the browser did not print the report ({type(error).__name__})",
                command[0],
                "name the report .html and print that",
            ) from error


def provenance() -> Provenance:
    """How the running command computes its result; files are those read so far."""
    import shlex

    from dashpot.present.pages.page import provenance_of

    context = click.get_current_context()
    arguments = context.meta.get(ARGUMENTS, ())
    command = shlex.join(["dashpot", *arguments])
    return provenance_of(command, tuple(_settings(context)), context.meta.get(LABELS, ()))


def _settings(context: click.Context) -> list[tuple[str, str, bool]]:
    """Options with their values, and whether they were given; what is not set is left out."""
    settings = []
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if not isinstance(parameter, click.Option) or value is None or value == () or value is False:
            continue
        source = context.get_parameter_source(parameter.name or "")
        given = source is not click.core.ParameterSource.DEFAULT
        name = next((name for name in parameter.opts if name.startswith("--")), parameter.opts[0])
        settings.append((name, "" if value is True else _shown(value), given))
    return settings


def _shown(value: Any) -> str:
    if isinstance(value, tuple | list):
        return ",".join(_shown(part) for part in value)
    return f"{value:g}" if isinstance(value, float) else str(value)[:200]
