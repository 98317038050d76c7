"""Training several methods one after the other, in pieces, and evaluating them together."""

import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from aicpg_newton import compare
from aicpg_newton.compare import PAPER, CompareOptions, trainings
from aicpg_newton.env.methods import METHODS, condition
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation import results
from aicpg_newton.evaluation.run import identity_of
from aicpg_newton.files import only_one
from aicpg_newton.learning import checkpoint, runner


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tasks with little learning."""

    def task(name: str, method: str) -> Task:
        found = get_task(name, method)
        found.learning.hidden_sizes = (16,)
        found.learning.steps_per_iteration = 4
        found.learning.minibatches = found.learning.epochs = 1
        return found

    monkeypatch.setattr(compare, "get_task", task)


@pytest.fixture
def minute_a_look(monkeypatch: pytest.MonkeyPatch) -> float:
    """A clock that goes on by a minute whenever it is read; returns how many minutes one iteration then needs."""
    minutes = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: 60.0 * next(minutes))
    monkeypatch.setattr(compare, "time", clock)
    monkeypatch.setattr(runner, "time", clock)
    return 1.5  # read when the comparison and when the training begin, and over at the first checkpoint


def test_the_papers_comparison_has_all_methods():
    """Nine trainings a seed, every method before the next seed, no two in one folder."""
    found = trainings(CompareOptions(out=Path("x"), seeds=(0, 1)))
    assert len(found) == 2 * len(PAPER) == 18
    assert [training.seed for training in found] == [0] * 9 + [1] * 9
    assert {training.task.method for training in found} == set(METHODS)
    assert [condition(training.task) for training in found[1:7]] == ["1.5", "2.0", "2.5", "3.0", "3.5", "4.0"]
    assert len({training.folder for training in found}) == 18
    assert found[3].folder == Path("x/flat_ppo_2.5_seed_0")


@pytest.mark.usefixtures("small")
def test_trainings_continue_where_time_ran_out_and_are_evaluated_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, minute_a_look: float
):
    """The same command does what is missing and no more; only when all is done it evaluates."""
    evaluated = []

    def begin_to_evaluate(protocols, controllers, laboratory, folder) -> None:
        """Only the first protocol is done."""
        evaluated.append(([each.name for each in protocols], controllers))
        folder.mkdir(exist_ok=True)
        description = {"controllers": identity_of(controllers, laboratory), "results": []}
        results.write(folder, protocols[0].name, [], description)

    monkeypatch.setattr(compare, "evaluate", begin_to_evaluate)
    monkeypatch.setattr(compare, "draw_all", lambda folders, out: [])
    settings = {"out": tmp_path / "c", "methods": ("ai-cpg", "ppo:2"), "seeds": (3,), "device": "cpu"}
    options = CompareOptions(**settings, max_iterations=2, save_interval=1, num_envs=2, test_envs=15, max_minutes=1e-9)
    assert not compare.compare(options)
    assert not (tmp_path / "c").exists()
    options.max_minutes = minute_a_look
    assert not compare.compare(options)
    first = tmp_path / "c" / "flat_seed_3"
    assert checkpoint.read(first)["iteration"] == 1
    assert not (tmp_path / "c" / "flat_ppo_2.0_seed_3").exists()
    assert not evaluated
    options.max_minutes = None
    killed = tmp_path / "c" / "flat_ppo_2.0_seed_3"
    killed.mkdir()
    (killed / "config.yaml").write_text("run: {}\n")
    assert compare.compare(options)
    written = {path: path.stat().st_mtime for path in tmp_path.rglob("model_*.pt")}
    assert {path.parent.name for path in written} == {"flat_seed_3", "flat_ppo_2.0_seed_3"}
    assert all(checkpoint.read(path.parent)["iteration"] == 2 for path in written)
    assert [(each.seed, each.task.method) for each in evaluated[0][1]] == [(3, "ai-cpg"), (3, "ppo")]
    for _ in range(3):
        assert compare.compare(options)
    wanted = ["sweep", "disturbance", "transition"]
    assert [names for names, _ in evaluated] == [wanted, wanted[1:], wanted[2:]]
    with pytest.raises(UserError, match="results of other controllers"):
        compare.compare(replace(options, methods=("ai-cpg",)))
    assert {path: path.stat().st_mtime for path in tmp_path.rglob("model_*.pt")} == written


def test_progress_is_a_row_for_each_and_the_time_left(tmp_path: Path):
    """30 of 200 iterations at first, 80 now after 100 s: 120 are left, at two seconds each."""
    everything = trainings(CompareOptions(out=tmp_path, methods=("ai-cpg", "ppo:1.5"), seeds=(0,)))
    lines = compare.progress(everything, (80, 0), 100, 30, 100.0).splitlines()
    assert lines[0].split() == ["flat_seed_0", "80", "of", "100", "iterations"] and len(lines) == 3
    assert lines[2] == "120 iterations are left: about 0 h 4 min at the rate of this job."
    assert len(compare.progress(everything, (80, 0), 100, 80, 100.0).splitlines()) == 2
    assert len(compare.progress(everything, (100, 100), 100, 30, 100.0).splitlines()) == 2


@pytest.mark.parametrize(
    ("task", "methods", "wanted"),
    [
        ("flat", ("ppo:1.5", "amp:walk"), ["sweep", "disturbance"]),
        ("flat", ("ppo:1.5", "ai-cpg"), ["sweep", "disturbance", "transition"]),
        ("uneven", ("amp:run",), ["sweep", "disturbance", "terrain"]),
        ("uneven", ("ai-cpg",), ["sweep", "disturbance", "transition", "terrain"]),
    ],
)
def test_what_is_compared_depends_on_ground_and_methods(task: str, methods: tuple[str, ...], wanted: list[str]):
    """The ramp where one follows the frequency, unseen terrain where the ground is uneven."""
    everything = trainings(CompareOptions(out=Path("x"), task=task, methods=methods, seeds=(0,)))
    assert [each.name for each in compare.protocols(everything)] == wanted


@pytest.mark.usefixtures("small")
def test_two_jobs_share_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    """What another job is at is left alone, its folder too; what is free is done."""
    monkeypatch.setattr(compare, "evaluate", lambda *_: pytest.fail("not all are finished"))
    busy = tmp_path / "flat_seed_0"
    busy.mkdir()
    (busy / "config.yaml").write_text("of a training without a checkpoint yet")
    settings = {"out": tmp_path, "methods": ("ai-cpg",), "device": "cpu", "num_envs": 2, "save_interval": 1}
    options = CompareOptions(**settings, seeds=(0, 1), max_iterations=1)
    with only_one(tmp_path / ".flat_seed_0.lock") as mine:
        assert mine
        assert not compare.compare(options)
    assert "flat_seed_0 is being trained by another job" in capsys.readouterr().out
    assert [path.name for path in busy.iterdir()] == ["config.yaml"]
    assert checkpoint.read(tmp_path / "flat_seed_1")["iteration"] == 1
    monkeypatch.setattr(compare, "evaluate", lambda *_: None)
    monkeypatch.setattr(compare, "draw_all", lambda *_: [])
    assert compare.compare(options)  # nobody is at it any more
    assert checkpoint.read(busy)["iteration"] == 1


@pytest.mark.usefixtures("small")
def test_another_training_in_the_folder_is_refused(tmp_path: Path, minute_a_look: float):
    """Settings that differ from those it was begun with are not mixed up with them."""
    settings = {"out": tmp_path, "methods": ("ai-cpg",), "seeds": (0,), "device": "cpu", "num_envs": 2}
    compare.compare(CompareOptions(**settings, max_iterations=2, save_interval=1, max_minutes=minute_a_look))
    with pytest.raises(UserError, match="trained with other settings"):
        compare.compare(CompareOptions(**settings, max_iterations=2, save_interval=2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"methods": ()}, "empty in part"),
        ({"methods": ("ai-cpg:1.5",)}, "has no conditions"),
        ({"methods": ("ppo:fast",)}, "does not give a number for target_speed"),
        ({"methods": ("ppo:-1",)}, "target_speed is -1"),
        ({"methods": ("amp:hop",)}, "'hop' for reference"),
        ({"methods": ("sac",)}, "unknown method"),
        ({"task": "moon"}, "unknown task"),
        ({"max_minutes": 0.0}, "--max-minutes is 0"),
        ({"max_iterations": 0}, "--max-iterations is 0"),
        ({"test_envs": 8}, "--test-envs is 8, but the evaluation has 15 frequencies"),
    ],
)
def test_bad_options(tmp_path: Path, changes: dict, message: str):
    """One sentence each, and no folder is left."""
    with pytest.raises(UserError, match=message):
        compare.compare(CompareOptions(out=tmp_path / "never", **changes))
    assert not (tmp_path / "never").exists()
