"""The command line: `parhelion COMMAND ...`; one module a command.

Exit codes: 0 done; 1 pictures differ (rerender, study) or a limit was exceeded (compare); 2 a
mistake in the request, the input or the output, told in one line; 130 stopped by Ctrl-C, with what
there was written.
"""

from __future__ import annotations

import argparse
import io
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from .. import __version__, arguments, machine
from ..errors import ParhelionError, spelled
from . import compare, convert, image, info, merge, pixel, render, rerender, study, view

COMMANDS = (render, view, merge, rerender, convert, image, compare, info, pixel, study)

EXIT_MISTAKE = 2
EXIT_INTERRUPTED = 130


class Parser(argparse.ArgumentParser):
    """Tells a mistake in one line; flags are not abbreviated, for a later one could be meant."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{"allow_abbrev": False, **settings})

    def error(self, message: str) -> NoReturn:
        """Ends the process with exit code 2."""
        self.exit(EXIT_MISTAKE, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    top = Parser(
        prog="parhelion", description="A path tracer for data: particles, spheres and arrays."
    )
    top.add_argument("--version", action="version", version=f"parhelion {__version__}")
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add(commands)
    for added in commands.choices.values():
        added.set_defaults(flags=_flags(added))
    # It speaks of how its files are made.
    made_by, merged = _flags(commands.choices["render"]), _flags(commands.choices["merge"])
    commands.choices["merge"].set_defaults(flags={**made_by, **merged})
    return top


def _flags(command: argparse.ArgumentParser) -> dict[str, str]:
    """What the command's options are called, by their names in Python: --bond-length, -D."""
    found: dict[str, str] = {}
    for action in command._actions:
        if action.option_strings:
            long = [flag for flag in action.option_strings if flag.startswith("--")]
            found[action.dest] = (long or action.option_strings)[0]
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit code."""
    args = parser().parse_args(argv)
    logging.basicConfig(format="%(levelname)s: %(message)s", stream=sys.stderr)
    level = "error" if getattr(args, "quiet", False) else getattr(args, "log_level", "warning")
    logging.getLogger("parhelion").setLevel(level.upper())
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name may hold what the terminal can not show
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with spelled(args.flags), _terminable(), machine.threads(_own_threads(args)):
            code: int = args.run(args)
        if sys.stdout is not None:  # None: the process was started without one
            sys.stdout.flush()
        return code
    except ParhelionError as error:
        return _mistake(error)
    except MemoryError:
        return _mistake("not enough memory")
    except BrokenPipeError:  # the reader of our output went away, as `| head` does
        _close_stdout()
        return 0
    except OSError as error:
        _close_stdout()
        return _mistake(f"{error.filename or 'output'}: {error.strerror or error}")
    except KeyboardInterrupt:
        print("parhelion: stopped", file=sys.stderr)
        return EXIT_INTERRUPTED


def _own_threads(args: argparse.Namespace) -> int:
    """Those by which files are read, too; a study has a list of them."""
    asked = getattr(args, "threads", 0)
    if not isinstance(asked, int):
        return 0
    return arguments.own_threads(asked, getattr(args, "cluster", None))


@contextmanager
def _terminable() -> Iterator[None]:
    """SIGTERM ends the block as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():  # no one else hears of signals
        yield
        return
    old = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, old)


def _mistake(reason: object) -> int:
    print(f"parhelion: error: {' '.join(str(reason).split())}", file=sys.stderr)
    return EXIT_MISTAKE


def _close_stdout() -> None:
    """Sends what is still to be flushed nowhere, so that nothing is said about it at exit."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
