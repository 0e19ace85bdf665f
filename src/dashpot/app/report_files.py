"""Reports as files: how a result was computed, and HTML or PDF."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import click

from dashpot.app.options import OUTPUT, Option, OutputFile
from dashpot.errors import ConvergenceError, DataError, IdentifiabilityError, UsageError
from dashpot.io.words import REPORTS, chosen_format

if TYPE_CHECKING:
    from dashpot.model.rigfile import Rig
    from dashpot.present.document import Provenance

ARGUMENTS = "dashpot.arguments"  # what was typed, in the context's meta
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-pdf-header-footer",
)


@dataclass(frozen=True)
class ReportFile:
    """The report that a command is to write, if any, and the lines at its head.

    A browser for PDF is looked for once all parameters have been checked, before the work.  Raises UsageError.
    """

    report: Annotated[
        str | None,
        Option("--report FILE.html|pdf", OutputFile(formats=REPORTS), OUTPUT),
        "Write a report with figures as one HTML file, or as PDF (needs Chromium or Chrome).",
    ]
    label: Annotated[
        tuple[str, ...],
        Option("--label TEXT", None, OUTPUT, multiple=True),
        "Print a line at the head of the report, such as 'Client: A. Smith'.  May be repeated.",
    ]

    def __post_init__(self) -> None:
        if self.label and self.report is None:
            context = click.get_current_context()
            raise click.UsageError("--label needs --report", context)
        if self.report is not None and is_pdf(self.report):
            browser()

    def __bool__(self) -> bool:
        return self.report is not None

    @property
    def provenance(self) -> Provenance:
        """How the running command computes its result; files are those read so far."""
        import shlex

        from dashpot.present.page import provenance_of

        context = click.get_current_context()
        command = shlex.join(["dashpot", *context.meta.get(ARGUMENTS, ())])
        labels = tuple(line for label in self.label if (line := " ".join(label.split())))
        # Options with their values, and whether they were given; what is not set is left out
        settings = []
        for parameter in context.command.params:
            value = context.params.get(parameter.name or "")
            unset = value is None or value is False or value == ()
            if not isinstance(parameter, click.Option) or unset or parameter.name == "label":
                continue
            source = context.get_parameter_source(parameter.name or "")
            given = source is not click.core.ParameterSource.DEFAULT
            name = next((name for name in parameter.opts if name.startswith("--")), parameter.opts[0])
            settings.append((name, "" if value is True else _shown(value), given))
        return provenance_of(command, tuple(settings), labels)

    def write(self, html: str) -> None:
        """Write the page, where a report is asked for.  Raises DataError."""
        if self.report is not None:
            write_report(self.report, html)

    @contextmanager
    def of_failure(self, rig: Rig) -> Iterator[None]:
        """Where the work inside gives no answer, the report says so, with the rig, before the error goes on."""
        try:
            yield
        except (IdentifiabilityError, ConvergenceError) as error:
            if self:
                from dashpot.present.identification import failure_report

                self.write(failure_report(rig.model, rig.channels, error, self.provenance))
            raise


def is_pdf(target: str) -> bool:
    """Whether a report of that name is to be a PDF file."""
    return chosen_format(target, REPORTS) == "pdf"


def browser() -> str:
    """The program that prints PDF.  Raises UsageError if there is none."""
    import shutil

    for name in BROWSERS:
        path = shutil.which(name)
        if path is not None:
            return path
    raise UsageError(
        "a PDF report is printed by Chromium or Chrome, and neither is installed",
        "--report",
        "install one, or write .html and print it from a browser",
    )


def write_report(target: str, html: str) -> None:
    """Write the page as HTML or, by the end of the name, as PDF.  Raises DataError."""
    from dashpot.io.atomic import write_bytes, write_text

    if is_pdf(target):
        write_bytes(target, _printed(html))
    else:
        write_text(target, html)


def _printed(html: str) -> bytes:
    """The page as PDF."""
    import subprocess

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
            # After two minutes a browser has hung: a page takes it two seconds.
            subprocess.run(command, capture_output=True, timeout=120, check=True)
            return files.read("report.pdf")
        except (OSError, subprocess.SubprocessError) as error:
            raise DataError(
                f"the browser did not print the report ({type(error).__name__})",
                command[0],
                "write .html and print it from a browser",
            ) from error


def _shown(value: Any) -> str:
    if isinstance(value, tuple | list):
        return ",".join(_shown(part) for part in value)
    return f"{value:g}" if isinstance(value, float) else str(value)[:200]
