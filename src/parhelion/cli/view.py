"""`parhelion view`: a scene in the browser, rendered while it is looked at."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from typing import TYPE_CHECKING

from .. import memory
from . import options

if TYPE_CHECKING:
    from ..scene import Scene


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "view",
        help="look at a scene in the browser",
        description="Renders a scene or particle file in the browser, better and better, while the"
        " camera, materials and lights can be changed. Files are read again when they change."
        " Ctrl-C ends it.",
    )
    options.add_loading(p)
    picture = p.add_argument_group("picture (default: what the scene says)")
    picture.add_argument("--width", type=int, metavar="N", help="at first; then as the window")
    picture.add_argument("--height", type=int, metavar="N")
    picture.add_argument(
        "--spp",
        "--samples",
        type=int,
        metavar="N",
        help="samples per pixel after which it rests; default: 4096",
    )
    picture.add_argument("--max-depth", type=int, metavar="N", help="rays in a path, at most")
    picture.add_argument("--seed", type=int, metavar="N", help="of all random numbers")
    picture.add_argument("--sampler", metavar="NAME", help="sobol or independent")
    picture.add_argument(
        "--integrator",
        metavar="NAME",
        help="path: all light; direct: scattered once at most; ao: how open the surroundings are",
    )
    server = p.add_argument_group("server")
    server.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="where to listen; with another than 127.0.0.1, whoever has the whole address of the"
        " page may come, from other machines too",
    )
    server.add_argument("--port", type=int, default=0, metavar="N", help="default: any free one")
    server.add_argument(
        "--no-browser",
        dest="browser",
        action="store_false",
        help="only print the page's address",
    )
    p.add_argument("-t", "--threads", type=int, default=0, metavar="N", help="default: all cores")
    p.add_argument(
        "--cluster",
        metavar="WHERE",
        help="who takes all samples but the first: local:N, the address of a scheduler of"
        " dask.distributed, or slurm:FILE; --threads are those of each worker then",
    )
    p.add_argument(
        "--memory-limit",
        metavar="SIZE",
        help="bytes, or 4G, 500M: what would take more is an error; default: what there is",
    )
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serves until Ctrl-C, which is no mistake here."""
    with memory.limited(args.memory_limit):
        return _serve(args)


def _serve(args: argparse.Namespace) -> int:
    from ..view.server import Server
    from ..view.session import DEFAULT_SPP, Session
    from ..view.watch import Watch, recorded

    names = ("width", "height", "max_depth", "seed", "sampler", "integrator")
    settings = {name: getattr(args, name) for name in names}
    spp = DEFAULT_SPP if args.spp is None else args.spp
    with options.naming(args):
        scene, files = recorded(lambda: options.load_scene(args))
        session = Session(scene, spp=spp, threads=args.threads, cluster=args.cluster, **settings)

    def load() -> Scene:
        with options.naming(args):
            return options.load_scene(args)

    with (
        session,
        Watch(session, load, files) as watch,
        Server(session, host=args.host, port=args.port) as server,
    ):
        print(server.url, flush=True)
        if not args.quiet:
            print("Ctrl-C ends it.", file=sys.stderr)
        if args.browser and _has_browser():
            import webbrowser

            webbrowser.open(server.url)
        with contextlib.suppress(KeyboardInterrupt):
            server.wait()
    if not watch.ended:
        # it is within the core, which cannot be stopped, and must not come back from there into a
        # Python that ends: that takes the process down
        os._exit(0)
    return 0


def _has_browser() -> bool:
    """Whether there is a screen: without one a browser of the terminal would be opened."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
