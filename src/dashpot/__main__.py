"""`python -m dashpot` and the command `dashpot`."""

from __future__ import annotations

import gc
import signal


def run_command() -> None:
    """Run the command.  Until it can answer Ctrl-C with one line, that ends the process without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Importing makes 10^5 objects and no rubbish; the usual 700 cost a tenth of a short command.  Arrays wait for none.
    gc.set_threshold(50_000)
    from dashpot.app.cli import main

    main()


if __name__ == "__main__":
    run_command()
