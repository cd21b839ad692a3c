"""The process around a command: ``python -m excitant`` and the script ``excitant``."""

import signal
import sys


def run() -> None:
    """Run a command and exit with its status; Ctrl-C and SIGTERM end it at any moment with 130."""
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        from excitant.cli import main

        status = main()
    except KeyboardInterrupt:  # amid imports
        status = 130
        print("excitant: interrupted; nothing was written", file=sys.stderr)
    for each in (signal.SIGINT, signal.SIGTERM):  # nothing is left to interrupt
        signal.signal(each, signal.SIG_IGN)
    sys.exit(status)


if __name__ == "__main__":
    run()
