"""``python -m excitant``."""

import sys

from excitant.cli import main

sys.exit(main())
