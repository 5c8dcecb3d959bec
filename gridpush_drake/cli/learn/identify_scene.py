"""`gridpush identify --with`: learns several objects together, from pushes through each other."""

from collections.abc import Sequence
from pathlib import Path

import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_found, work_progress
from gridpush_drake.dynamics.pusher import choose_pusher_radius
from gridpush_drake.errors import PushLogError
from gridpush_drake.files import write_together, write_whole
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import write_model
from gridpush_drake.identification.result import IdentificationStatus
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.scene_page import (
    explain_scene,
    make_scene_report,
    tell_scene,
)

EXIT_EXPLAINS_LITTLE = 3
"""Exit code if models were learned and written, but are far off from their own pushes."""

WITH_OPTION = "--with"
"""The option that names another object."""


def identify_together(
    named: Sequence[str],
    pushes: Path,
    out: Path,
    report: Path | None,
    largest_piece: bool,
    force: bool,
    json: bool,
) -> None:
    """Learns the objects of a scene log together, and writes a model of each.

    Args:
        named: the objects, as NAME=OBJECT.yaml or OBJECT.yaml.
        pushes: the scene log.
        out: the model file; each object's gets the object's name before the ending.
        report: the page to write.
        largest_piece: as of `options.LargestPiece`.
        force: whether files may be replaced.
        json: whether the result is printed for machines.
    """
    # the objects by the names that they have in the log
    files = []
    objects: dict[str, GridObject] = {}
    for text in named:
        given, file = options.split_name(text)
        obj = options.load_object(file, largest_piece)
        name = given or obj.name
        if name in objects:
            raise options.OptionError(
                f"{WITH_OPTION}: two objects are called {name!r}; expected NAME=OBJECT.yaml, with "
                "the "
                "name that the object's columns in the log begin with"
            )
        objects[name] = obj
        files.append(file)
    models_out = {name: out.with_stem(f"{out.stem}_{name}") for name in objects}
    outputs = list(models_out.values())
    options.check_outputs(force, *outputs, report, inputs=[*files, pushes])
    log = PushLog.read_csv(pushes, choose_pusher_radius([*objects.values()]))
    options.check_names(pushes, log, objects)

    options.compile_kernels()
    ordered = [objects[name] for name in log.names]
    with work_progress(f"identifying {count_noun(len(ordered), 'object')}"):
        found = identify(Model(ordered), log)
    models = found.parts
    if not found.moved.any():
        raise PushLogError(f"{pushes}: no push moved any of {', '.join(log.names)}")
    with write_together():
        for name, model in zip(log.names, models, strict=True):
            write_model(models_out[name], model, force)
        if report is not None:
            write_whole(report, make_scene_report(found, models, log), force)
    outputs = [models_out[name] for name in log.names]
    if report is not None:
        outputs.append(report)
    document = tell_scene(found, log.names)
    document["written"] = [str(path) for path in outputs]
    lines = explain_scene(found, models, log.names)
    lines.append("")
    lines += options.describe_written(*outputs)
    print_found(document, lines, json)
    if any(model.status == IdentificationStatus.EXPLAINS_LITTLE for model in models):
        raise typer.Exit(EXIT_EXPLAINS_LITTLE)
