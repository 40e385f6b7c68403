"""The program `parhelion`, which `python -m parhelion` is too."""

import sys


def main() -> int:
    """Runs the command line; returns its exit code."""
    try:
        from .cli import main as run

        return run()
    except KeyboardInterrupt:  # while modules are loaded; later the command answers itself
        print("parhelion: stopped", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
