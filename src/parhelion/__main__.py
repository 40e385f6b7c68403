"""`python -m parhelion` is the command `parhelion`."""

import sys

from .cli import main

sys.exit(main())
