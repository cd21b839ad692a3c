"""The process around a command: ``python -m excitant`` and the script ``excitant``."""

import gc
import io
import os
import sys

from excitant.interrupts import ignore, listen

# objects between two collections: a command makes many that stay, few cycles
COLLECTION_THRESHOLD = 1_000_000


def run() -> None:
    """Run a command and exit with its status; Ctrl-C, SIGTERM and SIGHUP end it with 130."""
    try:
        listen()
        for name in ("stdin", "stdout", "stderr"):
            stream = getattr(sys, name)
            if stream is None:  # it was closed: no file may take its number
                setattr(sys, name, open(os.devnull, "r+"))  # noqa: SIM115
            elif isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")  # where ° has no code
        gc.set_threshold(COLLECTION_THRESHOLD)
        from excitant.cli import main

        status = main()
        ignore()
    except KeyboardInterrupt:  # while modules are imported
        print("excitant: interrupted; nothing was written", file=sys.stderr)
        status = 130
    gc.freeze()  # what is left ends with the process, without a last collection
    sys.exit(status)


if __name__ == "__main__":
    run()
