"""Malformed inputs, generated, over all readers and options: a sentence, and nothing written, changed or waited for.

What still can be read goes on to the simulation, which is not built here: getting there is right as well.
"""

import dataclasses
import os
import random
import signal
import sys
import typing
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
import tyro

from aicpg_newton import benchmark, compare, evaluate, play, publish, train
from aicpg_newton.engines.interface import Physics
from aicpg_newton.engines.model import build
from aicpg_newton.env import environment
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import DEFAULT_METHOD, METHODS
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.figures import draw
from aicpg_newton.gait.cpg import DEFAULT_PATTERN, PatternNetwork
from aicpg_newton.learning import time_to_walk, work
from aicpg_newton.learning.plan import RunOptions, task_of
from aicpg_newton.learning.policy import load_policy
from aicpg_newton.learning.training import train as train_policy
from aicpg_newton.motion import __main__ as motion
from aicpg_newton.places import ASSETS
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.robot.humanoid import MJCF_PATH, motors
from tests import malformed
from tests.motion.conftest import Subject

SECONDS = 60
"""No input takes longer."""


class Reached(BaseException):
    """The input was good enough to begin."""


def publish_command() -> None:
    """``python -m aicpg_newton.publish``."""
    run_command(lambda: publish.publish(tyro.cli(publish.PublishOptions)))


def compare_command() -> None:
    """``python -m aicpg_newton.compare``."""
    run_command(lambda: compare.compare(tyro.cli(compare.CompareOptions)))


def benchmark_command() -> None:
    """``python -m aicpg_newton.benchmark``."""
    run_command(benchmark.main)


def motion_command() -> None:
    """``python -m aicpg_newton.motion``."""
    run_command(lambda: motion.fit(tyro.cli(motion.Fit)))


@pytest.fixture(autouse=True)
def nothing_is_built(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No simulation, no fit and no evaluation; whatever is written goes into a folder of the test's own."""

    def reached(*arguments: object, **options: object) -> None:
        raise Reached

    for module in (environment, work, time_to_walk):
        monkeypatch.setattr(module, "engine_for", reached)
    monkeypatch.setattr(motion, "fit_pattern_network", reached)
    monkeypatch.setattr(publish, "side_by_side", reached)
    monkeypatch.setattr(draw, "_save", lambda figure, path: path)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")


@contextmanager
def in_time() -> Iterator[None]:
    """A hang is a failure."""

    def stop(number: int, frame: object) -> None:
        raise AssertionError(f"not done after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every file and folder below a folder."""
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


class Tally:
    """Counts what becomes of inputs, and keeps what should not have."""

    def __init__(self, capsys: pytest.CaptureFixture, folder: Path) -> None:
        self.capsys, self.folder = capsys, folder
        self.refused = 0
        self.taken: list[str] = []
        self.wrong: list[str] = []

    def call(self, name: str, command: Callable[[], None], *arguments: object) -> None:
        """A command line as a user gives it."""
        before = contents(self.folder)
        self.capsys.readouterr()
        code: object = None
        try:
            with pytest.MonkeyPatch.context() as patch, in_time():
                patch.setattr(sys, "argv", ["command", *map(str, arguments)])
                command()
        except Reached:
            self.taken.append(name)
            return
        except SystemExit as end:
            code = end.code
        except BaseException as error:
            self.wrong.append(f"{name}: {type(error).__name__}: {error}"[:300])
            return
        said = self.capsys.readouterr().err
        if code is None:
            self.taken.append(name)
        elif code != 2 or "Traceback" in said or not said.strip():
            self.wrong.append(f"{name}: exit {code}, {said[-200:]!r}")
        else:
            self.refused += 1
        if contents(self.folder) != before and code is not None:
            self.wrong.append(f"{name}: files changed: {set(contents(self.folder)) ^ set(before)}")

    def read(self, name: str, reader: Callable[[], object]) -> None:
        """A reader below the command lines."""
        try:
            with in_time():
                reader()
            self.taken.append(name)
        except UserError as error:
            self.refused += 1
            if "\n" in str(error).strip():
                self.wrong.append(f"{name}: more than a line: {error}")
        except BaseException as error:
            self.wrong.append(f"{name}: {type(error).__name__}: {error}"[:300])

    def end(self, at_least: int, mostly_refused: bool = True) -> None:
        """All were as they should be, and there were enough of them."""
        assert not self.wrong, f"{len(self.wrong)} of {self.refused + len(self.taken)}:\n" + "\n".join(self.wrong)
        assert self.refused + len(self.taken) >= at_least
        assert self.refused > len(self.taken) or not mostly_refused


@pytest.fixture
def tally(capsys: pytest.CaptureFixture, tmp_path: Path) -> Tally:
    """Counts over a folder of the test's own."""
    return Tally(capsys, tmp_path)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint of a small training, with its optimiser."""
    task = get_task("flat")
    task.learning.hidden_sizes = (8,)
    task.learning.steps_per_iteration = 2
    folder = tmp_path_factory.mktemp("runs") / "run"
    return train_policy(task, RunOptions(num_envs=2, device="cpu", engine="mujoco", max_iterations=1, run_dir=folder))


def test_clips(tally: Tally, tmp_path: Path):
    """ASF and AMC."""
    subject = Subject(tmp_path)
    skeleton = subject.skeleton
    clips = {
        "walk": subject.motion("walk.amc", subject.stride_frames(0.9, 1.5)),
        "run": subject.motion("run.amc", subject.stride_frames(1.35, 1.2)),
    }
    good = {"--skeleton": skeleton, "--walk": clips["walk"], "--run": clips["run"], "--out": tmp_path / "net.pt"}
    for option in ("--skeleton", "--walk"):
        for name, data in malformed.of_text(good[option].read_text(encoding="utf-8")):
            bad = tmp_path / f"bad{good[option].suffix}"
            bad.write_bytes(data)
            chosen = {**good, option: bad}
            tally.call(f"{option} {name}", motion_command, *[each for pair in chosen.items() for each in pair])
    tally.end(90)


def test_pattern_networks(tally: Tally, tmp_path: Path):
    """Files, and content that torch reads without a word."""
    bad = tmp_path / "bad.pt"
    for name, data in malformed.of_binary(DEFAULT_PATTERN.read_bytes()):
        bad.write_bytes(data)
        tally.call(name, train.command, "--pattern", bad, "--device", "cpu")
    content = torch.load(DEFAULT_PATTERN, weights_only=True)
    gaits = [{**content, "gaits": changed["gaits"]} for _, changed in _of_gaits(content)]
    for name, changed in [*malformed.of_content(content, 2), *((f"gaits {i}", each) for i, each in enumerate(gaits))]:
        torch.save(changed, bad)
        tally.read(name, lambda: PatternNetwork.load(bad))
    tally.end(100, mostly_refused=False)


def _of_gaits(content: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Gaits that are missing, twice, or of other things."""
    first, second = content["gaits"]
    series = first["root_harmonics"]
    for gaits in ([], [first], [second, first], [first, first], {"walk": first}, [first, second, "run"], None):
        yield "gaits", {**content, "gaits": gaits}
    for name, changed in malformed.of_content(first, 1):
        yield name, {**content, "gaits": [changed, second]}
    for rows in (series[:-1], series[:3], [row[:5] for row in series], [[float("nan")] * 6] * len(series), "abc"):
        yield "series", {**content, "gaits": [{**first, "root_harmonics": rows}, second]}


def test_checkpoints(tally: Tally, trained: Path, tmp_path: Path):
    """As files that somebody broke on the way."""
    bad = tmp_path / "model_1.pt"
    for name, data in malformed.of_binary(trained.read_bytes()):
        bad.write_bytes(data)
        tally.call(name, play.command, "--checkpoint", bad, "--device", "cpu")
    tally.end(40, mostly_refused=False)


@pytest.mark.parametrize("door", ["play", "resume", "start-from", "evaluate", "publish"])
def test_contents_of_checkpoints(door: str, tally: Tally, trained: Path, tmp_path: Path):
    """As files that torch reads without a word."""
    bad = tmp_path / "model_1.pt"
    commands = {
        "play": (play.command, "--device", "cpu", "--checkpoint", bad),
        "resume": (train.command, "--device", "cpu", "--run-dir", "new", "--max-iterations", "9", "--resume", bad),
        "start-from": (train.command, "--device", "cpu", "--run-dir", "new", "--start-from", bad),
        "evaluate": (evaluate.command, "--device", "cpu", "--out", "out", "--protocol", "sweep", "--checkpoint", bad),
        "publish": (publish_command, "--out", "shipped", "--checkpoint", bad),
    }
    content = torch.load(trained, weights_only=True)
    cases = list(malformed.of_content({name: each for name, each in content.items() if name != "algorithm"}, 4))
    for name, changed in random.Random(door).sample(cases, 40):
        torch.save({**changed, "algorithm": content["algorithm"]}, bad)
        tally.call(f"{door}: {name}", *commands[door])
        if (tmp_path / "work" / "shipped").is_dir():
            for path in (tmp_path / "work" / "shipped").iterdir():
                path.unlink()
    tally.end(40, mostly_refused=False)


def test_networks_of_checkpoints(tally: Tally, trained: Path, puppet, pattern: PatternNetwork):
    """They are refused where they do not fit."""
    content = torch.load(trained, weights_only=True)
    task = task_of(trained)
    environment = Environment(task, puppet(2), pattern)
    for name, changed in malformed.of_content(content["algorithm"], 2):
        if name.startswith(("optimizer", "without optimizer", "a neighbour of optimizer")):
            continue
        tally.read(name, lambda changed=changed: load_policy(environment, {**content, "algorithm": changed}))
    tally.end(50, mostly_refused=False)


def test_mjcf(tally: Tally, tmp_path: Path):
    """Broken, and so that it says something else."""
    bad = tmp_path / "bad.xml"
    for name, data in malformed.of_text(MJCF_PATH.read_text(encoding="utf-8")):
        bad.write_bytes(data)
        tally.read(name, lambda: build(1, motors(), Physics(), bad))
    tally.end(45, mostly_refused=False)


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_results(suffix: str, tally: Tally, tmp_path: Path):
    """Of an evaluation, which figures are drawn from."""
    shipped = ASSETS / "policies" / "robust_evaluation"
    folder = tmp_path / "results"
    folder.mkdir()
    names = ("sweep", "transition") if suffix == "json" else ("sweep",)
    for name in names:
        for file in ("csv", "json"):
            (folder / f"{name}.{file}").write_bytes((shipped / f"{name}.{file}").read_bytes())
    path = folder / f"{names[-1]}.{suffix}"
    for name, data in malformed.of_text(path.read_text(encoding="utf-8")):
        path.write_bytes(data)
        tally.call(name, evaluate.command, "--redraw", folder, "--out", "figures")
        if (tmp_path / "work" / "figures").is_dir():
            (tmp_path / "work" / "figures").rmdir()
    tally.end(45, mostly_refused=False)


def numbers_of(settings: type, prefix: str = "") -> Iterator[str]:
    """Options of a dataclass that take numbers."""
    hints = typing.get_type_hints(settings)
    for each in dataclasses.fields(settings):
        hint, name = hints[each.name], f"{prefix}{each.name.replace('_', '-')}"
        if dataclasses.is_dataclass(hint):
            yield from numbers_of(typing.cast(type, hint), f"{name}.")
        elif {int, float} & {hint, *typing.get_args(hint)}:
            yield name


_NO_NUMBERS = ("-1", "nan", "inf", "x", "", "1e400", "-1e308", "0x10", "1,5", "9" * 400)


def bad_numbers(options: Iterable[str], several: int) -> Iterator[tuple[str, str]]:
    """Options with what is no number of theirs."""
    random_ = random.Random(malformed.SEED)
    for option in options:
        for value in random_.sample(
            ("-1", "nan", "inf", "x", "", "1e400", "-1e308", "0x10", "1,5", "9" * 400), several
        ):
            yield f"--{option}", value


DOORS: dict[str, tuple[Callable[[], None], list[str]]] = {
    **{
        f"train {name}": (
            train.command,
            [*numbers_of(RunOptions), *numbers_of(method.task)]
            if name == DEFAULT_METHOD
            else [option for option in numbers_of(method.task) if option not in set(numbers_of(Task))],
        )
        for name, method in METHODS.items()
    },
    "play": (play.command, list(numbers_of(PlayOptions))),
    "evaluate": (evaluate.command, list(numbers_of(evaluate.EvaluateOptions))),
    "compare": (compare_command, list(numbers_of(compare.CompareOptions))),
    "publish": (publish_command, list(numbers_of(publish.PublishOptions))),
}


@pytest.mark.parametrize("door", DOORS)
def test_numbers_of_options(door: str, tally: Tally, trained: Path):
    """Every option of every command that takes a number."""
    command, options = DOORS[door]
    fixed: list[object] = ["--device", "cpu"]
    if door.startswith("train"):
        fixed += ["--method", door.split()[1], "--run-dir", "new", "--ground.height-range", "0.1"]
    elif door in ("evaluate", "compare"):
        fixed += ["--out", "out"]
    elif door == "publish":
        fixed += ["--checkpoint", trained, "--out", "shipped"]
    for option, value in bad_numbers(options, 2 if door.startswith("train") else 6):
        kept = [each for i, each in enumerate(fixed) if option not in (each, fixed[i - 1])]
        tally.call(f"{option} {value[:20]!r}", command, *kept, option, value)
    tally.end(len(options) * 2)


def odd_paths(folder: Path) -> dict[str, str]:
    """What may stand for a file and is none."""
    (folder / "a folder").mkdir()
    (folder / "empty").write_bytes(b"")
    (folder / "loop").symlink_to("loop")
    os.mkfifo(folder / "pipe")
    odd = {name: str(folder / name) for name in ("a folder", "empty", "loop", "pipe", "nothing", "empty/below")}
    odd["not UTF-8"] = os.fsdecode(os.fsencode(folder) + b"/\xff\xfe.pt")
    return {**odd, "device": "/dev/zero", "too long": "x" * 5000, "no name": "", "control": "a\nb\x1b[2J"}


@pytest.mark.parametrize(
    ("command", "before"),
    [
        (train.command, ["--device", "cpu", "--run-dir", "new", "--pattern"]),
        (train.command, ["--device", "cpu", "--resume"]),
        (train.command, ["--device", "cpu", "--run-dir", "new", "--start-from"]),
        (play.command, ["--device", "cpu", "--checkpoint"]),
        (play.command, ["--device", "cpu", "--record"]),
        (play.command, ["--device", "cpu", "--filmstrip"]),
        (evaluate.command, ["--device", "cpu", "--out", "out", "--checkpoint"]),
        (evaluate.command, ["--out", "out", "--redraw"]),
        (evaluate.command, ["--device", "cpu", "--agent", "zero", "--out"]),
        (publish_command, ["--checkpoint"]),
        (compare_command, ["--device", "cpu", "--out"]),
        (benchmark_command, ["--device", "cpu", "--json"]),
        (motion_command, ["--skeleton", "a", "--run", "c", "--out", "d.pt", "--walk"]),
        (motion_command, ["--walk", "b", "--run", "c", "--out", "d.pt", "--skeleton"]),
    ],
    ids=lambda value: value[-1] if isinstance(value, list) else value.__module__.split(".")[-1],
)
def test_paths_of_options(command: Callable[[], None], before: list[str], tmp_path: Path, capsys):
    """Folders, pipes, loops, devices, names too long, in other encodings or with letters that clear a screen."""
    odd = odd_paths(tmp_path)
    tally = Tally(capsys, tmp_path / "work")
    for name, path in odd.items():
        tally.call(name, command, *before, path)
    tally.end(11, mostly_refused=False)


@pytest.mark.parametrize(
    ("command", "before"),
    [
        (train.command, ["--device", "cpu", "--run-dir"]),
        (train.command, ["--device", "cpu", "--resume"]),
        (play.command, ["--device", "cpu", "--record"]),
        (evaluate.command, ["--device", "cpu", "--agent", "zero", "--out"]),
        (compare_command, ["--device", "cpu", "--out"]),
        (publish_command, ["--checkpoint"]),
        (motion_command, ["--skeleton", "a", "--walk", "b", "--run", "c", "--out"]),
    ],
    ids=lambda value: value[-1] if isinstance(value, list) else value.__module__.split(".")[-1],
)
def test_paths_that_are_not_utf_8_are_refused(command: Callable[[], None], before: list[str], tmp_path: Path, capsys):
    """Before anything is made: TensorBoard, ONNX and MuJoCo take no such paths."""
    folder = os.fsdecode(os.fsencode(tmp_path / "work") + b"/M\xfcller")
    Path(folder).mkdir()
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as end:
        patch.setattr(sys, "argv", ["command", *before, f"{folder}/new"])
        command()
    said = capsys.readouterr().err
    assert end.value.code == 2 and said.count("\n") == 1
    assert "M\\xfcller/new' holds bytes that are not UTF-8; rename the file or the folder" in said
    assert not list(Path(folder).iterdir())


def test_words_of_options(tally: Tally):
    """Tasks, methods, devices, engines, choices."""
    cases = [
        (train.command, ["--task", "Flat"]),
        (train.command, ["--task", "../flat"]),
        (train.command, ["--task"]),
        (train.command, ["--method", "ppo:fast"]),
        (train.command, ["--method", "amp", "--reference", "hop"]),
        (train.command, ["--method", "ppo", "--reference", "run"]),
        (train.command, ["--method", "amp", "--target-speed", "2"]),
        (train.command, ["--target-speed", "2"]),
        (train.command, ["--imitation.replay-keep", "0.5"]),
        (train.command, ["--method", "amp", "--rewards.pattern-tracking.weight", "2"]),
        (train.command, ["--method", "ppo", "--frequencies.minimum", "0.7"]),
        (train.command, ["--device", "quantum"]),
        (train.command, ["--device", "cpu:99:1"]),
        (train.command, ["--engine", "bullet", "--device", "cpu"]),
        (train.command, ["--learner-device", "auto", "--device", "cpu"]),
        (train.command, ["--learning.activation", "step"]),
        (train.command, ["--learning.hidden-sizes", "8.5"]),
        (train.command, ["--learning.hidden-sizes"]),
        (train.command, ["--ground.shape", "moon", "--ground.height-range", "1"]),
        (train.command, ["--resume", "a", "--start-from", "b"]),
        (train.command, ["--surprise", "1"]),
        (train.command, ["flat"]),
        (train.command, ["--task", "flat\0"]),
        (play.command, ["--agent", "robot"]),
        (play.command, ["--viewer", "tv"]),
        (play.command, ["--task", "flat", "--terrain-seed", "3", "--device", "cpu"]),
        (play.command, ["--frequency", "0.9", "x"]),
        (play.command, ["--record", "walk.avi", "--device", "cpu"]),
        (evaluate.command, ["--out", "out", "--protocol", "dance"]),
        (evaluate.command, ["--protocol", "sweep"]),
        (evaluate.command, ["--out", "out", "--agent", "zero", "--checkpoint", "a"]),
        (evaluate.command, ["--out", "out", "--terrain-seed", "1", "--device", "cpu", "--task", "flat"]),
        (compare_command, ["--out", "out", "--methods", "ppo:fast", "--device", "cpu"]),
        (compare_command, ["--out", "out", "--methods", "--device", "cpu"]),
        (compare_command, ["--out", "out", "--methods", "ai-cpg:1", "--device", "cpu"]),
        (benchmark_command, ["--tasks", "moon"]),
        (benchmark_command, ["--seeds", "--device", "cpu"]),
        (publish_command, []),
        (motion_command, ["--walk", "a"]),
    ]
    for command, arguments in cases:
        tally.call(" ".join(arguments), command, *arguments)
    assert not tally.taken, tally.taken
    tally.end(len(cases))
