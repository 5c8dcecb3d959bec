"""`gridpush warm-up`: compiles the simulation to machine code before it is needed."""

from time import monotonic

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_found
from gridpush_drake.cli.shell.kernels import compile_all, compile_rare, is_rare_compiled
from gridpush_drake.dynamics.kernels.compiled import get_cache
from gridpush_drake.dynamics.kernels.rollout import rollout
from gridpush_drake.dynamics.warm_up import is_compiled


def warm_up(json: options.Json = False) -> None:
    """Compile the simulation to machine code now, so that no later command has to wait for it.

    This is needed once for each computer and each version of the package, and takes about four
    minutes on two idle cores. Without it, the first command that simulates a push compiles what
    that needs, in about 30 seconds. What only some commands need, such as steering or several
    objects, is then compiled by the first of them. The compiled code is kept in the folder that
    NUMBA_CACHE_DIR names, else in gridpush_drake below XDG_CACHE_HOME, else in
    ~/.cache/gridpush_drake.

    Example: gridpush warm-up
    """
    known = is_compiled() and is_rare_compiled()
    begin = monotonic()
    compile_all()
    compile_rare()
    folder = get_cache(rollout).cache_path or None
    seconds = monotonic() - begin
    found = {"folder": folder, "compiled": not known, "seconds": seconds}
    did = "was compiled before" if known else f"was compiled in {seconds:.0f} s"
    kept = (
        f"is kept in {folder}"
        if folder
        else "cannot be kept, as there is no folder that only you can change"
    )
    print_found(found, [f"The simulation {did}; the compiled code {kept}."], json)
