"""`gridpush warm-up`: compiles the kernels before they are needed."""

from time import monotonic

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_found
from gridpush_drake.cli.kernels import compile_all
from gridpush_drake.dynamics.kernels.compiled import get_cache
from gridpush_drake.dynamics.kernels.rollout import rollout
from gridpush_drake.dynamics.warm_up import is_compiled


def warm_up(json: options.Json = False) -> None:
    """Compile the kernels now, so that no later command has to; once a machine and version.

    They are kept in $NUMBA_CACHE_DIR, $XDG_CACHE_HOME/gridpush_drake or ~/.cache/gridpush_drake.
    """
    known, begin = is_compiled(), monotonic()
    compile_all()
    folder = get_cache(rollout).cache_path or None
    seconds = monotonic() - begin
    found = {"folder": folder, "compiled": not known, "seconds": seconds}
    did = "were compiled before" if known else f"were compiled in {seconds:.0f} s"
    kept = f"are kept in {folder}" if folder else "cannot be kept: no folder will do"
    print_found(found, [f"The kernels {did}; they {kept}."], json)
