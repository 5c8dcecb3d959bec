"""`gridpush export`: writes an object, a learned model or episodes for another program."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_found, print_notice
from gridpush_drake.files import write_together
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statements import describe_weighed
from gridpush_drake.multibody.mjcf import WriteMjcf
from gridpush_drake.multibody.sdformat import WriteSdf, WriteUrdf
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.units import MM_PER_M

Format = Literal["sdf", "urdf", "mjcf"]
"""A format that can be written."""

MAX_SAMPLES = 10_000
"""Most draws that are written at once."""

FORMAT_SUFFIXES: dict[str, Format] = {
    ".sdf": "sdf",
    ".urdf": "urdf",
    ".xml": "mjcf",
    ".mjcf": "mjcf",
}
"""The formats by the endings of files' names."""


def export(
    target: Annotated[
        str,
        typer.Argument(
            metavar="OBJECT|MODEL|CAMPAIGN",
            help="What to write: a shipped object's name, an object file, a model that `gridpush "
            "identify` wrote, or, with --lerobot, the folder of a campaign.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Argument(
            metavar="[OUT]",
            help="The file to write, unless --lerobot names a folder.",
            show_default=False,
        ),
    ] = None,
    file_format: Annotated[
        Format | None,
        typer.Option(
            "--format",
            help="SDFormat or URDF for Drake, MJCF for MuJoCo. All of them hold the mass and the "
            "friction of every cell; a comment in the file names what the format cannot say.",
            show_default="by the ending of OUT: .sdf, .urdf, .xml or .mjcf",
        ),
    ] = None,
    base: Annotated[
        Literal["free", "planar"],
        typer.Option(
            help="How the object may move: free with six degrees of freedom; planar (only with "
            "sdf) in the plane of the table, where each cell bears its own weight."
        ),
    ] = "free",
    height: options.Height = None,
    samples: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MAX_SAMPLES,
            metavar="N",
            help="Instead of the estimate, write N draws of what the masses may be by all that the "
            "pushes said: numbered files, such as block_1.sdf, for simulations that must work with "
            "each of them. Needs a learned model.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws, with --samples.")] = 0,
    lerobot: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Instead, write the episodes of a campaign that was run with --record as a "
            "LeRobot dataset (v3.0). Needs pip install '.\\[lerobot]'.",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Write an object or a learned model as a file for Drake (SDFormat, URDF) or MuJoCo (MJCF).

    Of an object that was not learned, mass and friction are spread evenly. With --lerobot the
    episodes of a campaign are written instead, for those who learn from what robots did.

    Example: gridpush export model.yaml hammer.sdf --base planar
    """
    if lerobot is not None:
        if out is not None:
            raise options.OptionError("OUT: goes without --lerobot, which names the folder")
        _export_episodes(Path(target), lerobot, force, json)
        return
    if out is None:
        raise options.OptionError("OUT: missing; expected the file to write, or --lerobot DIR")
    chosen = file_format or FORMAT_SUFFIXES.get(out.suffix)
    if chosen is None:
        raise options.OptionError(
            f"OUT: is {str(out)!r}; expected a name that ends in {', '.join(FORMAT_SUFFIXES)}, or "
            "--format"
        )
    if base == "planar" and chosen != "sdf":
        raise options.OptionError(
            f"--base: is 'planar', which only --format sdf can hold; expected 'free' with {chosen}"
        )
    outs = [out] if samples is None else name_samples(out, samples)
    options.check_outputs(force, *outs, inputs=(target,))
    loaded = options.load_target(target, largest_piece)
    obj = loaded.obj
    mass = loaded.params.total_mass
    height = options.choose_height(height, obj)
    if samples is None:
        drawn = [loaded.params]
    elif loaded.model is None:
        raise options.OptionError(
            f"--samples: {target} is an object, of which nothing was learned; expected a "
            "model.yaml that gridpush identify wrote"
        )
    else:
        drawn = loaded.model.draws(samples, seed)
    absolute = None if loaded.model is None else loaded.model.weighed
    note = "" if absolute is None else describe_weighed(absolute)
    if samples is not None and note:
        note = f"A draw of what is known: {note}"
    with write_together():
        for params, path in zip(drawn, outs, strict=True):
            if chosen == "sdf":
                WriteSdf(Model(obj, params), path, force, base=base, height=height, note=note)
            else:
                write = WriteUrdf if chosen == "urdf" else WriteMjcf
                write(Model(obj, params), path, force, height=height, note=note)
    if obj.prior.total_mass is None and absolute is None:
        print_notice(
            f"{speak_name(obj.name)}: its file has no total_mass; {mass:.3g} kg is assumed"
        )
    source = "learned model" if loaded.model else "object, mass and friction spread evenly"
    found = {
        "object": obj.name,
        "cells": obj.n,
        "total_mass": mass,
        "total_mass_interval": None if absolute is None else absolute.mass_interval,
        "format": chosen,
        "base": base,
        "height": height,
        "samples": samples,
        "seed": None if samples is None else seed,
        "written": [str(path) for path in outs],
    }
    line = (
        f"{speak_name(obj.name)} ({source}): {obj.n} cells, {mass:.3g} kg, "
        f"{height * MM_PER_M:.3g} mm high, "
        f"{base} base"
    )
    written = options.describe_written(out)
    if samples is not None:
        line += f", {count_noun(samples, 'draw')} of seed {seed}"
        written = [f"Wrote {outs[0]} to {outs[-1].name}." if samples > 1 else f"Wrote {outs[0]}."]
    print_found(found, [line, *written], json)


def _export_episodes(campaign: Path, out: Path, force: bool, json: bool) -> None:
    """Writes the episodes of a campaign as a LeRobot dataset, and says what was written."""
    # Imported here, as it brings all of the station, for which the other formats need not wait
    from gridpush_drake.station.campaign.lerobot_dataset import export_dataset

    exported = export_dataset(campaign, out, force)
    found = {
        "episodes": exported.episodes,
        "frames": exported.frames,
        "without_recording": exported.without_recording,
        "written": [str(out)],
    }
    episodes = count_noun(exported.episodes, "episode")
    lines = [f"{episodes}, {count_noun(exported.frames, 'frame')}."]
    if exported.without_recording:
        left_out = count_noun(exported.without_recording, "episode")
        lines.append(f"{left_out} without a recording left out.")
    print_found(found, [*lines, *options.describe_written(out)], json)


def name_samples(out: Path, count: int) -> list[Path]:
    """Names the files of draws: block.sdf becomes block_01.sdf, block_02.sdf and so on."""
    digits = len(str(count))
    return [out.with_name(f"{out.stem}_{i:0{digits}}{out.suffix}") for i in range(1, count + 1)]
