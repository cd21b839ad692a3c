"""The process around a command: ``python -m excitant`` and the script ``excitant``."""

import atexit
import os
import signal
import sys
from contextlib import suppress


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
    if status == 130:
        # Ctrl-C amid exec(), as of a dataclass, would end Python by that signal, whoever caught it
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    run()
