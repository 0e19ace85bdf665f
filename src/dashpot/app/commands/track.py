"""dashpot track: the unknowns of a rig over time, and when they change."""

from __future__ import annotations

from typing import Annotated, Any

import click

from dashpot.app import options as opt
from dashpot.app.workers import progress
from dashpot.errors import printable


@opt.dashpot_command(
    "dashpot track rig.toml record.csv --window 20s --figure track.svg",
    "dashpot track rig.toml logger.csv --window 60s --follow --json track.json",
    "dashpot track rig.toml record.parquet --window 20s --speed k1=1%",
)
def command(
    rig: opt.RigFile,
    record: Annotated[str, opt.Option("", opt.INPUT_FILE), "One continuous record."],
    window: Annotated[
        float,
        opt.Option("--window TIME", opt.TIME, required=True),
        "Length of the windows, such as 50 periods of the lowest mode; a change is dated to one window.",
    ],
    speed: Annotated[
        Any,
        opt.Option("--speed auto|1%|k1=1%,…", opt.SPEED, default="auto"),
        "Standard deviation of the change in one hour, as a share of the value: of all unknowns, or by name "
        "(the others then stay constant); auto estimates it.",
    ],
    false_alarms: Annotated[
        float,
        opt.Option("--false-alarms 1%", opt.PART, default=0.01),
        "Rate of false alarms: the share of records without a change in which one is announced.",
    ],
    band: opt.FreeBand,
    noise_record: Annotated[
        tuple[str, ...],
        opt.Option("--noise-record FILE", opt.INPUT_FILE, multiple=True),
        "An at-rest record, for the noise of every channel.  May be repeated.",
    ],
    follow: Annotated[
        float | None,
        opt.Option("--follow TIME", opt.TIME, alone="1e9"),
        "Keep reading as the file (text) grows, until it has not grown for this time; without a time until "
        "stopped.  Results are written with every window.",
    ],
    json_out: Annotated[str | None, opt.JSON, "the values over time and the changes"],
    out: Annotated[
        str | None,
        opt.Option("--out -o FILE.parquet", opt.OutputFile(formats=("parquet",)), opt.OUTPUT),
        "Write a table with a row for each window.",
    ],
    figure: Annotated[
        str | None, opt.FIGURE, "Draw the unknowns over time with their intervals and changes."
    ],
    level: opt.Level,
    seed: Annotated[
        int, opt.SEED, "the starts that ml draws, and of the simulations behind the significance"
    ],
    quiet: opt.Quiet,
) -> None:
    """Track the unknown masses, dampers and springs of RIG through one long RECORD, and report when they change.

    Each window of the record is identified separately. The values are then smoothed as a random walk, whose speed is
    estimated from the windows. Abrupt changes are reported with time, size and significance, gradual ones with their
    size.

    Exit codes: 0 done, changed or not; 2 bad usage, model or data; 3 the channels do not determine the unknowns;
    5 not enough memory.
    """
    from dashpot.data.conditioning.settings import Conditioning
    from dashpot.data.noise import noise_at_rest
    from dashpot.data.readers import read
    from dashpot.data.readers.pieces import records_in_pieces, windows_of
    from dashpot.fleet.tracking import Track, Tracker
    from dashpot.io import ledger
    from dashpot.io.json_document import to_json
    from dashpot.model.rigfile import read_rig
    from dashpot.present.document import say
    from dashpot.present.fleet import change_line, track_document

    known = read_rig(rig)
    rest = read(noise_record, known.channels).records if noise_record else ()
    still = noise_at_rest(rest, source=", ".join(noise_record)) if noise_record else None
    tracker = Tracker(known, Conditioning(band_hz="auto" if band is None else band, still=still), seed)
    chosen = None if speed == "auto" else speed

    def written() -> Track:
        track = tracker.track(speed=chosen, false_alarms=false_alarms)
        entries = ledger.current()
        if entries is not None:
            entries.write_anew()
        if json_out != opt.STDOUT or follow is None:
            opt.write_result(json_out, to_json(track.to_dict()))
        if out is not None:
            track.save(out)
        if figure is not None:
            from dashpot.present.figures.study import track_figure
            from dashpot.present.figures.style import write_figure

            write_figure(figure, track_figure(track, level))
        return track

    tracker.require_speed(chosen)
    announced: set[tuple[str, str]] = set()
    with progress("track", quiet or follow is not None):
        for one in windows_of(records_in_pieces(record, known.channels, follow=follow), window):
            if not tracker.add(one) or follow is None:
                continue
            for change in written().changes:
                if (change.name, change.kind) not in announced and not quiet and json_out != opt.STDOUT:
                    announced.add((change.name, change.kind))
                    click.echo(f"at {one.time[-1]:.6g} s: {printable(change_line(change))}")
        track = written()
    if follow is not None and json_out == opt.STDOUT:
        opt.write_result(json_out, to_json(track.to_dict()))
    if not quiet and json_out != opt.STDOUT:
        say(track_document(track, level))
