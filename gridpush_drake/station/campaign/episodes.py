"""`gridpush campaign`: whole episodes of a station's task with many seeds and objects.

An episode is one run of the task. Everything that is hidden or random is drawn from its seed, so
that whoever runs it again sees the same. What came of it is one line of a file
(`jobs.results.Results`).
"""

import gc
import json
import shlex
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from pydrake.common.yaml import yaml_dump_typed
from pydrake.multibody.parsing import ModelDirectives

from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.files import is_file, make_folder
from gridpush_drake.identification.absolute.errors import compare_with_truth
from gridpush_drake.jobs.results import Results
from gridpush_drake.jobs.run import QUIET_EXECUTION, Execution, run_jobs
from gridpush_drake.report.table import INTERVAL_CONFIDENCE, Proportion, Table, Value, calc_mean
from gridpush_drake.station.recording.run_recorder import RunRecorder, import_rosbags
from gridpush_drake.station.scene.contents import use_object
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import format_scenario, parse_scenario
from gridpush_drake.station.schema.task_table import DEFAULT_TASK
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.station.tasks.run_summary import calc_center_error
from gridpush_drake.station.tasks.task import Progress, StationTask, TaskRecord, TaskStatus
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

SCENARIO_FILE = "scenario.yaml"
"""File in a campaign's folder that has the scenario of its episodes."""

EPISODES_FILE = "episodes.jsonl"
"""File in a campaign's folder that has a line for each episode."""

TABLE_FILE = "table.md"
"""File in a campaign's folder that says what came of all episodes."""

RECORDINGS_FOLDER = "recordings"
"""Folder in a campaign's folder for the recordings of episodes, an MCAP file each."""

RECORDING_SUFFIX = ".mcap"
"""Ending of a recording's name."""

REPLAYS_FOLDER = "replays"
"""Folder in a campaign's folder for episodes that are run again."""

REFUSED_STATUS = "refused"
"""Status of an episode that could not be run for a reason that the package gives."""

BROKEN_STATUS = "error"
"""Status of an episode that could not be run for any other reason."""

DROPPED_OUTCOME = "dropped"
"""Outcome of an episode in which an object fell off the table."""

NOT_LIFTED = "not lifted"
"""Outcome of an episode whose object stayed behind when the gripper went up."""

GAVE_UP = "gave up"
"""Outcome of an episode that ended in any other way than it should."""

OUTCOME_MEANINGS = {
    DROPPED_OUTCOME: "off the table",
    NOT_LIFTED: "the gripper closed and went up, and the object stayed",
    GAVE_UP: "anything else",
}
"""What these outcomes mean, for a table's reader."""


@dataclass(frozen=True)
class EpisodeJob:
    """An episode to be run.

    Attributes:
        object: name of a shipped object, or an object file.
        seed: seed of everything random.
        object_hash: hash of the object's file where it is not a shipped one; empty otherwise.
        task: name of the task, one of TASK_KINDS.
        scenario: all else, as YAML.
        recording: the MCAP file that the episode is recorded in; empty for none. Episodes are the
            same with and without.
    """

    object: str
    seed: int
    object_hash: str = ""
    task: str = field(default=DEFAULT_TASK, compare=False)
    scenario: str = field(default="", compare=False)
    recording: str = field(default="", compare=False)

    def describe(self) -> str:
        """Says in a few words which episode it is."""
        return f"{Path(self.object).stem}, seed {self.seed}"

    def name_recording(self) -> str:
        """Names the episode's recording: by object, by its file's hash if it has one, and seed."""
        return "-".join(
            filter(
                None, [Path(self.object).stem, self.object_hash, f"{self.seed}{RECORDING_SUFFIX}"]
            )
        )


@dataclass(frozen=True)
class EpisodeOutcome:
    """What came of an episode.

    Attributes:
        object: name of a shipped object, or an object file.
        seed: seed of everything random.
        status: status of the run, or REFUSED_STATUS or BROKEN_STATUS.
        message: the status in a sentence.
        outcome: the task's `done`, DROPPED_OUTCOME (off the table), NOT_LIFTED, or GAVE_UP for
            anything else.
        pushes: number of pushes that were made.
        pokes: number of those that were made to learn only; None where the task does not tell them
            apart.
        slides: number of those towards the edge; None where the task does not tell them apart.
        raised: how far the object's lowest point was above the table at the end, m; None where it
            is not lifted.
        center_of_mass_error: of the last estimate, m; None where nothing was learned.
        duration: simulated, s.
        wall: what it took, s, with making the station.
        mass_error: error of the last estimate of the mass, relative to it; this and what follows is
            None where nothing was weighed.
        friction_error: error of the last estimate of the mean friction coefficient.
        mass_holds: whether the 95 % interval of the mass holds it.
        center_holds: whether the 95 % region of the center of mass holds it.
        friction_holds: whether the 95 % interval of the mean friction holds it.
    """

    object: str
    seed: int
    status: str
    message: str
    outcome: str
    pushes: int = 0
    pokes: int | None = None
    slides: int | None = None
    raised: float | None = None
    center_of_mass_error: float | None = None
    duration: float = 0.0
    wall: float = 0.0
    mass_error: float | None = None
    friction_error: float | None = None
    mass_holds: bool | None = None
    center_holds: bool | None = None
    friction_holds: bool | None = None


def run_episode(job: EpisodeJob) -> EpisodeOutcome:
    """Runs an episode.

    What the package refuses, and whatever else goes wrong in it, is how the episode ended. If the
    job asks for a recording, it is written when the episode has ended, whatever came of it; an
    episode that could not be run has none.

    Raises:
        OutputError: the recording cannot be written.
    """
    # A station that was dropped takes hundreds of megabytes, of which Python sees next to nothing.
    gc.collect()
    begin = perf_counter()
    recorder = RunRecorder() if job.recording else None
    try:
        task = make_episode_task(job)
        record = task.run(progress=_watch(task, recorder))
    except GridPushError as error:
        return _give_up(job, REFUSED_STATUS, str(error), perf_counter() - begin)
    except Exception as error:
        *_, last = traceback.extract_tb(error.__traceback__)
        message = (
            f"{type(error).__name__} in {Path(last.filename).name}, line {last.lineno}: {error}"
        )
        return _give_up(job, BROKEN_STATUS, message, perf_counter() - begin)
    if record.status == TaskStatus.INTERRUPTED:
        raise KeyboardInterrupt
    if recorder is not None:
        # A recording of an episode that is run again takes the place of the earlier one
        recorder.write(Path(job.recording), record, force=True)
    fell = _has_fallen(task)
    done = TASK_KINDS[job.task].done
    ends = {done: str(done), TaskStatus.DROPPED: DROPPED_OUTCOME, TaskStatus.NOT_LIFTED: NOT_LIFTED}
    outcome = DROPPED_OUTCOME if fell else ends.get(record.status, GAVE_UP)
    return _make_episode(job, record, outcome, perf_counter() - begin)


def make_episode_task(job: EpisodeJob) -> StationTask[Any]:
    """Makes the task of an episode, which `run_episode` runs.

    Raises:
        GridPushError: the scenario or the object is refused.
    """
    scenario = parse_scenario(Path("scenario.yaml"), job.scenario)
    known_object = use_object(scenario, job.object)
    scenario.seed = job.seed
    return TASK_KINDS[job.task].make_task(resolve(scenario, known_object=known_object))


def _give_up(job: EpisodeJob, status: str, message: str, wall: float) -> EpisodeOutcome:
    """Makes the outcome of an episode that could not be run."""
    return EpisodeOutcome(
        object=job.object,
        seed=job.seed,
        status=status,
        message=message,
        outcome=GAVE_UP,
        wall=wall,
    )


def _has_fallen(task: StationTask[Any]) -> bool:
    """Says whether any object, by its true pose, is not on the table any more."""
    names = ["object", *(other.name for other in task.station.others)]
    return any(np.isnan(task.read(f"{name}.pose_true")).any() for name in names)


def _watch(task: StationTask[Any], recorder: RunRecorder | None) -> Progress | None:
    """Makes what a running task tells after each step, so that it is recorded; None for nothing."""
    if recorder is None:
        return None
    return lambda status, logged: recorder.note(task)


def _make_episode(job: EpisodeJob, record: TaskRecord, outcome: str, wall: float) -> EpisodeOutcome:
    """Makes an episode of what came of its run."""
    episode = EpisodeOutcome(
        object=job.object,
        seed=job.seed,
        status=str(record.status),
        message=record.message,
        outcome=outcome,
        duration=record.duration,
        wall=wall,
        **TASK_KINDS[job.task].count_made(record),
    )
    if record.estimates:
        error = calc_center_error(record, record.estimates[-1].params)
        episode = replace(episode, center_of_mass_error=error)
        absolute = record.estimates[-1].absolute
        if absolute is not None and record.truth is not None:
            errors = compare_with_truth(absolute, record.obj, record.truth)
            episode = replace(
                episode,
                mass_error=errors.mass,
                friction_error=errors.friction,
                mass_holds=errors.mass_holds,
                center_holds=errors.center_holds,
                friction_holds=errors.friction_holds,
            )
    return episode


@dataclass(frozen=True)
class Campaign:
    """The episodes of a campaign.

    Attributes:
        task: name of the task, one of TASK_KINDS.
        folder: folder of the campaign, where its scenario lies.
        episodes: all episodes, by object and seed.
    """

    task: str
    folder: Path
    episodes: Sequence[EpisodeOutcome]

    @property
    def done(self) -> str:
        """The outcome of an episode that ended as it should."""
        return str(TASK_KINDS[self.task].done)

    @property
    def ends(self) -> list[str]:
        """The outcomes, for the table's columns; NOT_LIFTED only where an episode had it."""
        lifted = all(episode.outcome != NOT_LIFTED for episode in self.episodes)
        return (
            [self.done, DROPPED_OUTCOME, GAVE_UP]
            if lifted
            else [self.done, DROPPED_OUTCOME, NOT_LIFTED, GAVE_UP]
        )

    @property
    def failures(self) -> list[EpisodeOutcome]:
        """The episodes that did not end as they should."""
        return [episode for episode in self.episodes if episode.outcome != self.done]

    def make_replay(self, episode: EpisodeOutcome) -> str:
        """Makes the command that runs an episode again, and writes its recording and report."""
        out = self.folder / REPLAYS_FOLDER / f"{Path(episode.object).stem}-{episode.seed}"
        words = [
            "gridpush",
            "demo",
            "--task",
            self.task,
            "--scenario",
            str(self.folder / SCENARIO_FILE),
        ]
        return shlex.join(
            [*words, "--object", episode.object, "--seed", str(episode.seed), "--out", str(out)]
        )

    def count(self) -> Iterator[tuple[str, list[EpisodeOutcome], dict[str, Proportion]]]:
        """Counts outcomes by object, and of all objects where there are several.

        Yields:
            Each object's name, its episodes, and how many of them had each outcome.
        """
        names = list(dict.fromkeys(episode.object for episode in self.episodes))
        groups = [
            (name, [episode for episode in self.episodes if episode.object == name])
            for name in names
        ]
        for name, group in [*groups, ("all", list(self.episodes))][
            : len(groups) + (len(groups) > 1)
        ]:
            ends = [episode.outcome for episode in group]
            yield name, group, {end: Proportion.of(ends.count(end), len(ends)) for end in self.ends}

    def tabulate(self) -> Table:
        """Makes a row for each object and one of all, and notes on each failure.

        They say why an episode failed, and how it is run again.
        """
        rows: list[tuple[Value, ...]] = []
        averaged = [
            name for name, (key, _) in AVERAGED_FIELDS.items() if _list_known(self.episodes, key)
        ]
        for name, group, fractions in self.count():
            means = [
                AVERAGED_FIELDS[each][1] * calc_mean(_list_known(group, AVERAGED_FIELDS[each][0]))
                for each in averaged
            ]
            rows.append(
                (
                    Path(name).stem,
                    len(group),
                    *(fraction.describe() for fraction in fractions.values()),
                    *means,
                )
            )
        meanings = [
            f"{end}: {OUTCOME_MEANINGS[end]}." for end in self.ends if end in OUTCOME_MEANINGS
        ]
        notes = [
            f"In brackets: {PERCENT_PER_ONE * INTERVAL_CONFIDENCE:g} % Wilson intervals. "
            f"{' '.join(meanings)}"
            " The rest: means of magnitudes, of all episodes in which it was found."
        ]
        if "mass held, %" in averaged:
            notes.append(
                "held: fraction of the weighed episodes whose 95 % interval has the truth."
            )
        for failure in self.failures:
            name = Path(failure.object).stem
            notes.append(f"{name}, seed {failure.seed}: {failure.status}. {failure.message}")
            notes.append(self.make_replay(failure))
        columns = ("object", "episodes", *self.ends, *averaged)
        return Table(f"Episodes of {self.task} in the station", columns, rows, notes)

    def to_dict(self) -> dict[str, Any]:
        """Returns outcomes by object and all failures for machines, in SI units."""
        objects = [
            {"object": name, **{end: asdict(fraction) for end, fraction in fractions.items()}}
            for name, _, fractions in self.count()
        ]
        failures = [
            {**asdict(failure), "replay": self.make_replay(failure)} for failure in self.failures
        ]
        return {"task": self.task, "objects": objects, "failures": failures}


AVERAGED_FIELDS = {
    "pushes": ("pushes", 1.0),
    "pokes": ("pokes", 1.0),
    "slides": ("slides", 1.0),
    "CoM error, mm": ("center_of_mass_error", MM_PER_M),
    "mass error, %": ("mass_error", PERCENT_PER_ONE),
    "friction error": ("friction_error", 1.0),
    "mass held, %": ("mass_holds", PERCENT_PER_ONE),
    "CoM held, %": ("center_holds", PERCENT_PER_ONE),
    "friction held, %": ("friction_holds", PERCENT_PER_ONE),
    "simulated, s": ("duration", 1.0),
}
"""Columns of means of magnitudes: fields of an episode, and what they are multiplied by."""


def _list_known(episodes: Sequence[EpisodeOutcome], key: str) -> list[float]:
    """Lists magnitudes of a field of the episodes in which it was found."""
    values = [getattr(episode, key) for episode in episodes]
    return [abs(float(value)) for value in values if value is not None]


def describe_settings(task: str, scenario: PushScenario) -> dict[str, Any]:
    """Describes all that a campaign's episodes depend on, but object and seed, by its place.

    It is what `open_results` compares.
    """
    own = {"object", "seed", "directives"}
    settings = {"task": task, **_flatten("scenario", scenario.model_dump(exclude=own))}
    directives = yaml_dump_typed(
        ModelDirectives(directives=scenario.directives), schema=ModelDirectives
    )
    return {**settings, "scenario.directives": " ".join(directives.split())}


def _flatten(place: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        return {place: value}
    return {
        key: inner
        for name, each in value.items()
        for key, inner in _flatten(f"{place}.{name}", each).items()
    }


def run(
    task: str,
    scenario: PushScenario,
    objects: dict[str, str],
    seeds: Sequence[int],
    folder: Path,
    execution: Execution = QUIET_EXECUTION,
    record: bool = False,
) -> Campaign:
    """Runs the episodes that are not known yet.

    Args:
        task: name of the task, one of TASK_KINDS.
        scenario: scenario of all episodes; its object and seed do not matter.
        objects: names of shipped objects or object files, with the hash of the file of those that
            are not shipped.
        seeds: seeds of the episodes with each object.
        folder: folder of the campaign, where the scenario lies.
        execution: how the episodes are run.
        record: whether each episode is recorded, in RECORDINGS_FOLDER in the folder. An episode
            that is known but was not recorded is run again.

    Returns:
        All episodes, those that were known before among them.

    Raises:
        GridPushError: there is no object or no seed; see `run_jobs`.
        MissingExtraError: episodes are to be recorded, and `rosbags` is not installed.
        OutputError: the folder of the recordings, or one of them, cannot be written.
    """
    if not objects or not seeds:
        raise GridPushError(f"{'seeds' if objects else 'objects'}: none; expected at least one")
    text = format_scenario(scenario)
    jobs = [
        EpisodeJob(object=name, seed=seed, object_hash=digest, task=task, scenario=text)
        for seed in seeds
        for name, digest in objects.items()
    ]
    if record:
        jobs = _record_all(jobs, folder, execution.results)
    found = run_jobs(run_episode, jobs, EpisodeJob.describe, execution)
    order = {name: at for at, name in enumerate(objects)}
    return Campaign(
        task, folder, sorted(found, key=lambda episode: (order[episode.object], episode.seed))
    )


def read_episodes(folder: Path) -> tuple[str, list[tuple[EpisodeJob, EpisodeOutcome]]]:
    """Reads which episodes a campaign has run, and what came of them.

    Args:
        folder: folder of the campaign.

    Returns:
        The name of the task; and the episodes, by object and seed, each with its job. The jobs lack
        the scenario, which lies in the folder.

    Raises:
        GridPushError: the folder is of no campaign, or holds no episode.
    """
    path = folder / EPISODES_FILE
    expected = "expected the folder of a campaign"
    if not is_file(path):
        raise GridPushError(f"{folder}: there is no {EPISODES_FILE}; {expected}")
    try:
        head, *lines = [json.loads(line) for line in path.read_bytes().splitlines()]
        task = str(head["settings"]["task"])
        # Of an episode that was run again the last line counts
        known = {}
        for line in lines:
            job = EpisodeJob(**line["job"][1], task=task)
            known[job.object, job.object_hash, job.seed] = (job, EpisodeOutcome(**line["result"]))
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise GridPushError(f"{path}: is no file of a campaign's episodes; {expected}") from error
    if not known or task not in TASK_KINDS:
        raise GridPushError(f"{path}: holds no episode of a task; {expected}")
    return task, [known[key] for key in sorted(known)]


def drop_recordings(folder: Path) -> None:
    """Removes the recordings of a campaign that is begun anew: they are of other episodes.

    Args:
        folder: folder of the campaign.

    Raises:
        OutputError: one cannot be removed.
    """
    for path in (folder / RECORDINGS_FOLDER).glob(f"*{RECORDING_SUFFIX}"):
        try:
            path.unlink()
        except OSError as error:
            raise OutputError(f"{path}: cannot be removed: {error.strerror}") from error


def _record_all(
    jobs: Sequence[EpisodeJob], folder: Path, results: Results | None
) -> list[EpisodeJob]:
    """Tells each job where its episode is recorded, and forgets results of those that were not.

    Args:
        jobs: the jobs.
        folder: folder of the campaign.
        results: the results that are kept; None for none.

    Returns:
        The jobs, each with the full path of its recording, as a worker may be in another folder.
    """
    import_rosbags()
    recordings = folder.resolve() / RECORDINGS_FOLDER
    make_folder(recordings)
    recorded = [replace(job, recording=str(recordings / job.name_recording())) for job in jobs]
    known = {} if results is None else results.find(run_episode, recorded)
    for at, episode in known.items():
        # One that could not be run would have no recording the next time either
        has_none = episode.status in (REFUSED_STATUS, BROKEN_STATUS)
        if results is not None and not has_none and not is_file(recorded[at].recording):
            results.forget(recorded[at])
    return recorded
