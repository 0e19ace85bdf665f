"""`python -m dashpot` and the command `dashpot`."""

from __future__ import annotations

import signal


def main() -> None:
    """Run the command.  Until it can answer Ctrl-C with one line, that ends the process without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from dashpot.app.cli import main as command

    command()


if __name__ == "__main__":
    main()
