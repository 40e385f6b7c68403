"""The command line: `parhelion COMMAND ...`; one module a command.

Exit codes: 0 done; 2 a mistake in the request, the input or the output, told in one line; 130
stopped by Ctrl-C, with what there was written.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence

from .. import __version__
from ..errors import ParhelionError
from . import info, render, study

COMMANDS = (render, info, study)

EXIT_MISTAKE = 2
EXIT_INTERRUPTED = 130


def parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    top = argparse.ArgumentParser(
        prog="parhelion", description="A path tracer for data: particles, spheres and arrays."
    )
    top.add_argument("--version", action="version", version=f"parhelion {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    args = parser().parse_args(argv)
    level = getattr(args, "log_level", "warning").upper()
    logging.basicConfig(level=level, format="%(levelname)s: %(message)s", stream=sys.stderr)
    try:
        code: int = args.run(args)
        sys.stdout.flush()
        return code
    except ParhelionError as error:
        print(f"parhelion: error: {error}", file=sys.stderr)
        return EXIT_MISTAKE
    except MemoryError:
        print("parhelion: error: not enough memory", file=sys.stderr)
        return EXIT_MISTAKE
    except BrokenPipeError:
        # The reader of our output went away, as `| head` does; say nothing at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print("parhelion: stopped", file=sys.stderr)
        return EXIT_INTERRUPTED
