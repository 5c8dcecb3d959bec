"""Writes the recorded episodes of a campaign as a LeRobot dataset, version 3.0 of its format.

It needs the packages `pyarrow` and `rosbags`, not `lerobot` itself. The folder has

    meta/info.json, meta/stats.json, meta/tasks.parquet
    meta/episodes/chunk-000/file-000.parquet     a row for each episode, with its statistics
    data/chunk-000/file-000.parquet              a row for each frame, of all episodes
    meta/gridpush.json                           which episode is which, and how it ended

`station.campaign.lerobot_frames` says what is in a frame. Pictures are kept in the data's files, as
the JPEG files that were recorded.
"""

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cv2
import numpy as np

from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.extras import import_extra
from gridpush_drake.files import exists, is_file
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.station.campaign.episodes import (
    RECORDINGS_FOLDER,
    SCENARIO_FILE,
    EpisodeJob,
    EpisodeOutcome,
    read_episodes,
)
from gridpush_drake.station.campaign.lerobot_frames import (
    FRAMES_PER_SECOND,
    PICTURES_FEATURE,
    Frames,
    make_frames,
)
from gridpush_drake.station.recording.run_recording import read_run
from gridpush_drake.station.robot.robot import find_robot
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.units import BYTES_PER_MEGABYTE

FORMAT_VERSION = "v3.0"
"""Version of the format."""

CHUNK_SIZE = 1000
"""Most files in a folder of a dataset."""

MAX_FILE_SIZE = 100
"""Size at which a file of frames is full, MB."""

VIDEO_FILE_SIZE = 200
"""Size at which a file of films would be full, MB; the format asks for it, there are no films."""


STATISTIC_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""Quantiles in the statistics, by their names in the format."""

BRIGHTNESS_LEVELS = 256
"""Brightnesses that a pixel may have."""

MAX_PICTURES = 100
"""Pictures of an episode of which statistics are made, at most."""

DATA_FILE = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_FILE = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
"""Names of the files, as the format writes them."""

INFO_FILE = "meta/info.json"
"""File by which a folder is known for a dataset."""


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        episodes: number of episodes.
        frames: number of frames.
        without_recording: number of the campaign's episodes that have no recording.
    """

    episodes: int
    frames: int
    without_recording: int


def export_dataset(campaign: Path, out: Path, force: bool = False) -> Exported:
    """Writes the recorded episodes of a campaign as a LeRobot dataset.

    Args:
        campaign: folder of the campaign.
        out: folder to write, whole or not at all.
        force: whether a dataset that is there is replaced.

    Raises:
        MissingExtraError: `pyarrow` or `rosbags` is not installed.
        OutputError: the folder is there, or cannot be written.
        GridPushError: the folder is of no campaign, none of its episodes is recorded, or a
            recording cannot be read.
    """
    import_extra("pyarrow", "lerobot")
    import_extra("rosbags", "lerobot")
    check_folder(out, force)
    task, jobs = read_episodes(campaign)
    recorded = [
        (job, episode, campaign / RECORDINGS_FOLDER / job.name_recording()) for job, episode in jobs
    ]
    found = [row for row in recorded if is_file(row[2])]
    if not found:
        raise GridPushError(
            f"{campaign}: none of its {len(jobs)} episodes has a recording; expected a campaign "
            "that was run with --record"
        )
    scenario = read_scenario(campaign / SCENARIO_FILE)
    robot = find_robot(scenario.directives, scenario.packages, scenario.pusher)
    scratch = _make_scratch(out)
    try:
        writer = _Writer(scratch, task, robot.arm_model)
        for job, episode, path in found:
            writer.add(job, episode, make_frames(read_run(path)), path)
        writer.finish()
        _put(scratch, out)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return Exported(
        episodes=len(found),
        frames=writer.frames,
        without_recording=len(jobs) - len(found),
    )


def check_folder(out: Path, force: bool) -> None:
    """Checks that a dataset may be written to a folder.

    Raises:
        OutputError: it is there and `force` is not set, or is no dataset.
    """
    if not exists(out):
        if not exists(out.parent):
            raise OutputError(f"{out}: its folder {out.parent} does not exist")
        return
    if not out.is_dir():
        raise OutputError(f"{out}: is a file; expected a folder to write")
    if not any(out.iterdir()):
        return
    if not is_file(out / INFO_FILE):
        raise OutputError(f"{out}: holds something else than a dataset; expected another folder")
    if not force:
        raise OutputError(f"{out}: exists; pass --force to replace it")


def _make_scratch(out: Path) -> Path:
    """Makes a folder beside the one to write, which takes its place when it is whole."""
    try:
        return Path(mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error.strerror}") from error


def _put(scratch: Path, out: Path) -> None:
    """Puts a whole folder in the place of another."""
    scratch.chmod(out.parent.stat().st_mode & 0o777)
    if exists(out):
        shutil.rmtree(out)
    scratch.rename(out)


class _Writer:
    """Writes a dataset, episode by episode."""

    def __init__(self, folder: Path, task: str, robot: str) -> None:
        self.folder = folder
        self.frames = 0
        self._task = task
        self._robot = robot
        self._arrow = import_extra("pyarrow", "lerobot")
        self._parquet = import_module("pyarrow.parquet")
        self._names: dict[str, tuple[str, ...]] = {}
        self._picture_shape: tuple[int, int, int] | None = None
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []
        self._episodes: list[dict[str, Any]] = []
        self._all: list[dict[str, Any]] = []
        self._histograms: list[Array] = []
        self._file: Any = None
        self._file_index = -1
        self._file_size = 0

    def add(self, job: EpisodeJob, episode: EpisodeOutcome, frames: Frames, source: Path) -> None:
        """Adds an episode.

        Raises:
            GridPushError: it has other features than the episodes before.
        """
        words = TASK_KINDS[self._task].sentence.format(speak_name(Path(job.object).stem))
        task = self._tasks.setdefault(words, len(self._tasks))
        histogram = self._check(frames, source)
        count = len(frames)
        columns = self._make_columns(frames, episode, task)
        statistics = {name: calc_statistics(values) for name, values in columns.items()}
        if histogram is not None:
            statistics[PICTURES_FEATURE] = calc_picture_statistics(histogram)
            self._histograms.append(histogram)
        chunk, file = self._write_frames(columns, frames)
        row = {
            "episode_index": len(self._rows),
            "tasks": [words],
            "length": count,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + count,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for name, each in statistics.items():
            row |= {f"stats/{name}/{key}": value for key, value in each.items()}
        self._rows.append(row)
        self._all.append(columns)
        about = {"episode_index": row["episode_index"], "recording": source.name}
        self._episodes.append(about | asdict(episode))
        self.frames += count

    def finish(self) -> None:
        """Writes what is known only at the end."""
        self._file.close()
        names = self._all[0].keys()
        everything = {
            name: np.concatenate([columns[name] for columns in self._all]) for name in names
        }
        statistics = {name: calc_statistics(values) for name, values in everything.items()}
        if self._histograms:
            statistics[PICTURES_FEATURE] = calc_picture_statistics(np.sum(self._histograms, axis=0))
        meta = self.folder / "meta"
        path = self.folder / EPISODES_FILE.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True)
        self._parquet.write_table(self._arrow.Table.from_pylist(self._rows), path)
        self._parquet.write_table(self._make_tasks(), meta / "tasks.parquet")
        _write_json(meta / "stats.json", statistics)
        _write_json(meta / "gridpush.json", {"task": self._task, "episodes": self._episodes})
        _write_json(self.folder / INFO_FILE, self._describe())

    def _check(self, frames: Frames, source: Path) -> Array | None:
        """Checks that an episode has the features of those before.

        Returns:
            The histogram of its pictures' brightnesses; None without pictures.
        """
        shape, histogram = None, None
        if frames.pictures is not None:
            shape, histogram = count_brightnesses(frames.pictures)
        if not self._rows:
            self._names = frames.names
            self._picture_shape = shape
        if frames.names != self._names or shape != self._picture_shape:
            raise GridPushError(
                f"{source}: has other joints or pictures than the episodes before it; expected "
                "recordings of one robot and one camera"
            )
        return histogram

    def _make_columns(self, frames: Frames, episode: EpisodeOutcome, task: int) -> dict[str, Any]:
        """Makes the columns of numbers, each with a row for each frame, by their names."""
        count = len(frames)
        at = np.arange(count)
        last = at == count - 1
        done = str(TASK_KINDS[self._task].done)
        columns: dict[str, Any] = {
            name: values.astype(np.float32) for name, values in frames.values.items()
        }
        columns["next.done"] = last
        columns["next.success"] = last & (episode.outcome == done)
        columns["timestamp"] = (at / FRAMES_PER_SECOND).astype(np.float32)
        columns["frame_index"] = at
        columns["episode_index"] = np.full(count, len(self._rows))
        columns["index"] = self.frames + at
        columns["task_index"] = np.full(count, task)
        return columns

    def _write_frames(self, columns: dict[str, Any], frames: Frames) -> tuple[int, int]:
        """Writes the frames of an episode; returns the numbers of the folder and the file."""
        arrow = self._arrow
        arrays = {}
        for name, values in columns.items():
            flat = arrow.array(values.ravel())
            width = 1 if values.ndim == 1 else values.shape[1]
            is_vector = values.ndim > 1
            arrays[name] = arrow.FixedSizeListArray.from_arrays(flat, width) if is_vector else flat
        if frames.pictures is not None:
            pictures = [
                {"bytes": picture, "path": f"frame-{i:06d}.jpg"}
                for i, picture in enumerate(frames.pictures)
            ]
            kind = arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())])
            arrays[PICTURES_FEATURE] = arrow.array(pictures, type=kind)
        table = arrow.table(arrays)
        if (
            self._file is None
            or self._file_size + table.nbytes > MAX_FILE_SIZE * BYTES_PER_MEGABYTE
        ):
            self._begin_file(table.schema)
        self._file.write_table(table)
        self._file_size += table.nbytes
        return divmod(self._file_index, CHUNK_SIZE)

    def _begin_file(self, schema: Any) -> None:
        """Begins the next file of frames."""
        if self._file is not None:
            self._file.close()
        self._file_index += 1
        self._file_size = 0
        chunk, file = divmod(self._file_index, CHUNK_SIZE)
        path = self.folder / DATA_FILE.format(chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self._parquet.ParquetWriter(path, schema)

    def _make_tasks(self) -> Any:
        """Makes the table of tasks. Pandas, by which LeRobot reads it, takes the words as index."""
        table = self._arrow.table(
            {"task_index": list(self._tasks.values()), "task": list(self._tasks)}
        )
        description = {
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [
                _describe_column("task_index", "int64"),
                _describe_column("task", "unicode"),
            ],
            "pandas_version": "2.0.0",
        }
        return table.replace_schema_metadata({"pandas": json.dumps(description)})

    def _describe(self) -> dict[str, Any]:
        """Makes the content of `INFO_FILE`."""
        features: dict[str, Any] = {}
        for name, values in self._all[0].items():
            features[name] = {
                "dtype": str(values.dtype),
                "shape": [1] if values.ndim == 1 else [values.shape[1]],
                "names": list(self._names[name]) if name in self._names else None,
            }
        if self._picture_shape is not None:
            features[PICTURES_FEATURE] = {
                "dtype": "image",
                "shape": list(self._picture_shape),
                "names": ["height", "width", "channels"],
            }
        return {
            "codebase_version": FORMAT_VERSION,
            "robot_type": self._robot,
            "total_episodes": len(self._rows),
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK_SIZE,
            "data_files_size_in_mb": MAX_FILE_SIZE,
            "video_files_size_in_mb": VIDEO_FILE_SIZE,
            "fps": FRAMES_PER_SECOND,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": DATA_FILE,
            "video_path": None,
            "features": features,
        }


def _describe_column(name: str, kind: str) -> dict[str, Any]:
    """Describes a column as pandas does in the files that it writes."""
    return {
        "name": name,
        "field_name": name,
        "pandas_type": kind,
        "numpy_type": "object" if kind == "unicode" else kind,
        "metadata": None,
    }


def calc_statistics(values: Array) -> dict[str, list[Any]]:
    """Calculates the format's statistics of a feature.

    Args:
        values: (n,) or (n, k) numbers.

    Returns:
        Least and greatest value, mean, standard deviation and quantiles, each a list of k numbers
        or of one; and the number n.
    """
    rows = values.reshape(len(values), -1).astype(np.float64)
    found = {
        "min": rows.min(axis=0),
        "max": rows.max(axis=0),
        "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
        "count": np.array([len(rows)]),
    }
    for name, fraction in STATISTIC_QUANTILES.items():
        found[name] = np.quantile(rows, fraction, axis=0)
    return {name: numbers.tolist() for name, numbers in found.items()}


def count_brightnesses(pictures: Sequence[bytes]) -> tuple[tuple[int, int, int], Array]:
    """Counts how often each brightness occurs in pictures, of which some may be left out.

    Args:
        pictures: files of pictures, all of one size.

    Returns:
        Height, width and number of colors; and for red, green and blue (3, 256) the counts, with
        the number of pictures that were looked at in a last column (3, 257).
    """
    step = max(1, -(-len(pictures) // MAX_PICTURES))
    chosen = pictures[::step]
    counts = np.zeros((3, BRIGHTNESS_LEVELS + 1))
    shape = (0, 0, 3)
    for picture in chosen:
        bgr = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
        assert bgr is not None
        height, width, _ = bgr.shape
        shape = (height, width, 3)
        for channel in range(3):
            # OpenCV has blue first, the format red
            levels = bgr[..., 2 - channel].ravel()
            counts[channel, :BRIGHTNESS_LEVELS] += np.bincount(levels, minlength=BRIGHTNESS_LEVELS)
    counts[:, BRIGHTNESS_LEVELS] = len(chosen)
    return shape, counts


def calc_picture_statistics(counts: Array) -> dict[str, Any]:
    """Calculates the format's statistics of pictures, of each color from 0 to 1.

    Args:
        counts: (3, 257) what `count_brightnesses` counted, or a sum of such.

    Returns:
        As `calc_statistics`, but each a list (3, 1, 1), and the number of pictures.
    """
    levels = np.arange(BRIGHTNESS_LEVELS) / (BRIGHTNESS_LEVELS - 1)
    found: dict[str, list[float]] = {}
    for histogram in counts[:, :BRIGHTNESS_LEVELS]:
        fraction = histogram / histogram.sum()
        there = levels[histogram > 0]
        mean = float(fraction @ levels)
        numbers = {
            "min": float(there[0]),
            "max": float(there[-1]),
            "mean": mean,
            "std": float(np.sqrt(fraction @ (levels - mean) ** 2)),
        }
        below = np.cumsum(fraction)
        for name, quantile in STATISTIC_QUANTILES.items():
            numbers[name] = float(levels[np.searchsorted(below, quantile)])
        for name, number in numbers.items():
            found.setdefault(name, []).append(number)
    statistics: dict[str, Any] = {
        name: [[[number]] for number in numbers] for name, numbers in found.items()
    }
    statistics["count"] = [int(counts[0, BRIGHTNESS_LEVELS])]
    return statistics


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")
