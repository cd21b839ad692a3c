"""The process around a command: ``python -m excitant`` and the script ``excitant``."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from contextlib import suppress

_AGAIN = 0.1  # s after an interrupt that was lost
# objects between collections: a command makes many that stay, few cycles
_GARBAGE = 1_000_000


def run() -> None:
    """Run a command and exit with its status; Ctrl-C and SIGTERM end it at any moment with 130."""
    sys.unraisablehook = _interrupt_again
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        gc.set_threshold(_GARBAGE)
        from excitant.cli import main
        from excitant.processes import may_fork

        may_fork()
        status = main()
    except KeyboardInterrupt:  # amid imports
        status = 130
        print("excitant: interrupted; nothing was written", file=sys.stderr)
    for each in (signal.SIGINT, signal.SIGTERM):  # nothing is left to interrupt
        signal.signal(each, signal.SIG_IGN)
    # not sys.exit: it takes 0.3 s to free what ends with the process, and Ctrl-C amid exec(), as of
    # a dataclass, would end Python by that signal, whoever caught it
    if status != 130:  # work that was interrupted is not waited for
        import threading

        threading._shutdown()  # type: ignore[attr-defined]  # it ends the processes of joblib
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, AttributeError):  # none where there is no terminal
            stream.flush()
    os._exit(status)


def _interrupt_again(lost: sys.UnraisableHookArgs) -> None:
    """Where Python had to drop an interrupt, as within a destructor, send it once more."""
    import threading  # not above: nothing may take long before interrupts are waited for

    if issubclass(lost.exc_type, KeyboardInterrupt):
        threading.Timer(_AGAIN, os.kill, (os.getpid(), signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(lost)


if __name__ == "__main__":
    run()
