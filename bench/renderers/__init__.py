"""One module a renderer. Each has

    open(job: dict) -> tuple[dict, Callable[[dict], dict]]

which makes the scene of a job (see bench/measure.py) and returns what is known of the renderer and
a function that renders once. That takes {"spp", "seed", "save", ...} and returns {"seconds", ...}:
wall-clock time of rendering alone. "save" names a .npy file for the linear picture, or is None.

Each runs in a process of its own; see bench/worker.py.
"""
