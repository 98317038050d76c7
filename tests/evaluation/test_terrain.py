"""Evaluating on uneven terrain, whole trainings, and controllers that follow no stride frequency; no physics."""

import math
import weakref
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aicpg_newton import evaluate as command_line
from aicpg_newton.engines.terrain import Terrain
from aicpg_newton.env import environment
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.evaluate import EvaluateOptions, main
from aicpg_newton.evaluation import results, terrain_summaries
from aicpg_newton.evaluation import run as running
from aicpg_newton.evaluation.controllers import trained
from aicpg_newton.evaluation.protocols import PROTOCOLS, TRAINING
from aicpg_newton.evaluation.summaries import Source
from aicpg_newton.evaluation.trajectories import record
from aicpg_newton.figures.draw import draw_all
from aicpg_newton.learning.runner import Runner


@pytest.fixture
def worlds(monkeypatch: pytest.MonkeyPatch, glider) -> list[Task]:
    """Short protocols with robots that glide; the tasks that engines were made for."""
    made: list[Task] = []

    def engine_for(task: Task, name: str, num_envs: int, device: torch.device):
        made.append(task)
        return glider(num_envs, Terrain.make(task.ground))

    protocols = {
        name: replace(protocol, duration=2.5 if protocol.whole_training else 3.5)
        for name, protocol in PROTOCOLS.items()
    }
    monkeypatch.setattr(environment, "engine_for", engine_for)
    monkeypatch.setattr(running, "SWEEP", protocols["sweep"])
    monkeypatch.setattr(command_line, "PROTOCOLS", protocols)
    return made


@pytest.fixture
def make_run(tmp_path: Path, glider, pattern):
    """A function that makes a run folder of untrained networks."""

    def make(name: str, task: Task, seed: int = 0, iterations: tuple[int, ...] = (9,)) -> Path:
        task.learning.hidden_sizes = (8,)
        folder = tmp_path / name
        folder.mkdir()
        runner = Runner(Environment(task, glider(2, Terrain.make(task.ground)), pattern), {"seed": seed, "num_envs": 2})
        for iteration in iterations:
            runner.current_learning_iteration = iteration
            runner.save(str(folder / f"model_{iteration}.pt"))
        return folder

    return make


def ppo(task: str, speed: float) -> Task:
    """The PPO baseline for a speed."""
    return get_task(task, f"ppo:{speed}")


def options(out: Path, *checkpoints: Path, **changes) -> EvaluateOptions:
    """Four environments."""
    return EvaluateOptions(**{"checkpoint": checkpoints, "num_envs": 4, "device": "cpu", "out": out, **changes})


def test_walking_and_running_on_unseen_terrain(make_run, worlds: list[Task], tmp_path: Path):
    """A row per gait and terrain, and means over terrains; each terrain is another; no strips of lower heights."""
    strips = get_task("uneven")
    strips.ground.levels = 4
    runs = make_run("cpg", strips), make_run("slow", ppo("uneven", 1.5)), make_run("fast", ppo("uneven", 3.0))
    out = tmp_path / "out"
    main(options(out, *runs, task="uneven", protocol="terrain", terrain_seed=(11, 12)))
    rows = results.read_table(out, "terrain")
    told = [(row["method"], row["condition"], row["gait"], row["terrain_seed"], row["reason"]) for row in rows]
    assert told == [
        *(("AI-CPG", "", gait, seed, "") for seed in (11, 12) for gait in ("walking", "running")),
        *(("PPO", "1.5", "walking", seed, "") for seed in (11, 12)),
        *(("PPO", "3.0", "running", seed, "") for seed in (11, 12)),
    ]
    # Two environments for a gait of AI-CPG, all four for the only one of PPO.
    assert [row["speed_mps"] for row in rows] == pytest.approx(
        [1.25, 2.25, 1.25, 2.25, 1.75, 1.75, 1.75, 1.75], rel=1e-3
    )
    assert [row["frequency_hz"] for row in rows[:2]] == pytest.approx([0.9, 1.3]) and math.isnan(
        rows[4]["frequency_hz"]
    )
    assert [(task.method, task.ground.seed, task.ground.levels) for task in worlds] == [
        *(("ai-cpg", 11, 1), ("ai-cpg", 12, 1), ("ppo", 11, 1), ("ppo", 12, 1)),
    ]
    first, second = (Terrain.make(task.ground) for task in worlds[:2])
    assert first is not None and second is not None and (first.heights - second.heights).abs().mean() > 0.01
    content = results.read_description(out, "terrain")
    assert content["controllers"][0]["ground"]["terrain_seeds"] == [11, 12]
    walking, running_too = content["results"][0]["over_terrains"]
    assert walking["gait"] == "walking" and running_too["speed_mps"]["mean"] == pytest.approx(2.25, rel=1e-3)
    assert walking["survived"]["mean"] == 1.0 and walking["sole_penetration_m"]["terrains"] == 2
    assert {path.name for path in out.glob("*.png")} == {"figure_5b.png"}
    with pytest.raises(UserError, match="other controllers or ground"):
        main(options(out, *runs, task="uneven", protocol="sweep", num_envs=15, terrain_seed=(11, 13)))
    main(options(tmp_path / "flat", runs[1], task="flat", protocol="sweep"))
    with pytest.raises(UserError, match="on different ground; draw"):
        main(EvaluateOptions(redraw=(out, tmp_path / "flat"), out=tmp_path / "both"))


def test_means_over_terrains_by_hand():
    """0.5 and 1.5 m/s; where no terrain has a value, the reason is kept."""
    numbers = dict.fromkeys(terrain_summaries._MEASURES, 1.0)
    rows = [
        {**numbers, "gait": "walking", "frequency_hz": 0.9, "speed_mps": v, "survived": share, "reason": "fell"}
        | {"symmetry_index": math.nan}
        for v, share in ((0.5, 1.0), (1.5, 0.5))
    ]
    (walking,) = terrain_summaries.over_terrains(rows)["over_terrains"]
    assert walking["speed_mps"] == {"mean": 1.0, "std": 0.5, "terrains": 2, "reason": ""}
    assert walking["symmetry_index"] == {"mean": None, "std": None, "terrains": 0, "reason": "fell"}
    assert walking["survived"]["mean"] == 0.75


@pytest.mark.parametrize(("ground", "more"), [("flat", []), ("uneven", ["terrain"])])
def test_terrain_is_part_of_everything_where_the_ground_is_uneven(
    ground: str, more: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    """And a training never is."""
    asked: list[str] = []
    monkeypatch.setattr(command_line, "evaluate", lambda protocols, *_: asked.extend(each.name for each in protocols))
    monkeypatch.setattr(command_line, "draw_all", lambda *_: [])
    main(EvaluateOptions(agent="zero", task=ground, device="cpu", out=tmp_path))
    assert asked == ["sweep", "disturbance", "transition", "slowing", "up_and_down", "speed", *more]


@pytest.mark.parametrize("seed", [0, 1003])
def test_terrain_of_the_training_is_refused(seed: int, make_run, worlds: list[Task], tmp_path: Path):
    """1003 is one of the test's own; training's default is not, unless asked for."""
    task = get_task("uneven")
    task.ground.seed = seed
    run = make_run("run", task)
    asked = {"terrain_seed": (7, 0)} if seed == 0 else {}
    with pytest.raises(UserError, match=f"AI-CPG, seed 0 was trained on the terrain of seed {seed}"):
        main(options(tmp_path / "out", run, protocol="terrain", **asked))
    assert not worlds
    if seed == 0:
        main(options(tmp_path / "out", run, protocol="terrain"))
        assert [task.ground.seed for task in worlds] == [1001, 1002, 1003, 1004, 1005]


def test_a_whole_training(make_run, worlds: list[Task], monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Twelve of fifteen checkpoints; five samples of up to four robots each; no record outlives its checkpoint."""
    made: list[weakref.ref] = []

    def remembered(*arguments):
        assert not [each for each in made if each() is not None]
        trajectories = record(*arguments)
        made.append(weakref.ref(trajectories))
        return trajectories

    monkeypatch.setattr(running, "record", remembered)
    run = make_run("run", get_task("flat"), iterations=tuple(range(0, 150, 10)))
    other = make_run("other", ppo("flat", 1.5), seed=1, iterations=(0, 10))
    out = tmp_path / "out"
    main(options(out, run, other, protocol="training"))
    assert len(made) == 14
    rows = results.read_table(out, "training")
    mine = [row for row in rows if row["method"] == "AI-CPG"]
    iterations = sorted({row["iteration"] for row in mine})
    assert len(iterations) == 12 and (iterations[0], iterations[-1]) == (1, 141)
    assert len(mine) == 12 * 2 * 2 * 5 and len(rows) - len(mine) == 2 * 4 * 5
    assert {row["gait"] for row in mine} == {"walking", "running"}
    assert {row["gait"] for row in rows if row["condition"]} == {"walking"}
    way = [row for row in mine if (row["iteration"], row["gait"], row["environment"]) == (1, "running", 1)]
    assert [row["time_s"] for row in way] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5])
    assert [row["x_m"] for row in way] == pytest.approx([2.5 * (30 * i - 1) / 60 for i in range(1, 6)], abs=1e-3)
    assert [row["vx_mps"] for row in way] == pytest.approx([2.5] * 5, abs=1e-3)
    assert (out / "figure_5a.png").exists()
    checkpoints = results.read_description(out, "training")["controllers"][0]["checkpoints"]
    assert {"model_0.pt", "model_140.pt"} <= {each["file"] for each in checkpoints}
    with pytest.raises(UserError, match=r"AI-CPG, seed 0 has no more than one; give --checkpoint its run folder"):
        main(options(tmp_path / "single", run / "model_10.pt", protocol="training"))


def test_a_way_ends_with_the_fall(glider, pattern):
    """After 0.75 s: one more row, with the velocity since the one before."""
    engine = glider(1)
    engine.fall_at = {0: 44}
    environment = Environment(get_task("flat"), engine, pattern)
    start = torch.tensor([0.9])
    protocol = replace(TRAINING, duration=2.0)
    trajectories = record(protocol, start, environment, lambda observed: observed.new_zeros(len(observed), 28))
    rows, summary = terrain_summaries.training_rows(trajectories, start, Source("AI-CPG", 0, 5))
    assert [row["time_s"] for row in rows] == pytest.approx([0.5, 0.75])
    assert [row["reason"] for row in rows] == ["", "fell"] and rows[1]["vx_mps"] == pytest.approx(1.0, abs=1e-3)
    (walking,) = summary["gaits"]
    assert walking["survived"] == 0.0 and walking["mean_time_in_first_episode_s"] == pytest.approx(44 / 60)
    assert walking["mean_distance_in_first_episode_m"] == pytest.approx(44 / 60, abs=1e-3)


def test_baselines_have_one_condition(make_run, worlds: list[Task], tmp_path: Path, capsys: pytest.CaptureFixture):
    """A row per controller in sweep and disturbance, no part in the transition; speeds of one seed are told apart."""
    slow, fast = make_run("slow", ppo("flat", 1.5)), make_run("fast", ppo("flat", 3.0))
    run = make_run("style", get_task("flat", "amp:run"))
    out = tmp_path / "out"
    main(options(out, slow, fast, run))  # four environments: enough where there is but one condition
    sweep, disturbance = results.read_table(out, "sweep"), results.read_table(out, "disturbance")
    for rows in (sweep, disturbance):
        assert [(row["method"], row["condition"]) for row in rows] == [("PPO", "1.5"), ("PPO", "3.0"), ("AMP", "run")]
        assert all(math.isnan(row["frequency_hz"]) and row["reason"] == "" for row in rows)
        assert [row["speed_mps"] for row in rows] == pytest.approx([1.75] * 3, rel=1e-3)
    assert not (out / "transition.csv").exists() and not (out / "speed.csv").exists()
    assert (out / "figure_3.png").exists()
    left_out = "left out, as they follow none: PPO 1.5, seed 0; PPO 3.0, seed 0; AMP run, seed 0."
    told = capsys.readouterr().err
    assert f"The transition protocol turns the stride frequency; {left_out}" in told and "The speed" in told
    for name in ("transition", "speed"):
        with pytest.raises(UserError, match=f"the {name} protocol turns the stride frequency, which PPO 1.5, seed 0"):
            main(options(tmp_path / name, slow, protocol=name))
    with pytest.raises(UserError, match=r"two checkpoints are of PPO 1\.5, seed 0"):
        main(options(tmp_path / "twice", slow, slow, protocol="sweep"))
    cpg = make_run("cpg", get_task("flat"))
    main(options(tmp_path / "mixed", slow, cpg, protocol="transition"))
    assert {row["method"] for row in results.read_table(tmp_path / "mixed", "transition")} == {"AI-CPG"}
    assert "left out, as they follow none: PPO 1.5, seed 0." in capsys.readouterr().err


def test_gaits_of_baselines(make_run):
    """That of the speed they were trained for; a Froude number of 0.5 is passed at 2.05 m/s."""
    gaits = [trained(make_run(str(v), ppo("flat", v))).gait for v in (1.5, 2.0, 2.5, 4.0)]
    assert gaits == ["walking", "walking", "running", "running"]
    styles = [trained(make_run(name, get_task("flat", f"amp:{name}"))).gait for name in ("walk", "run")]
    assert styles == ["walking", "running"] and trained(make_run("cpg", get_task("flat"))).gait == ""


def test_checkpoints_of_different_ground_need_a_task(make_run, worlds: list[Task], tmp_path: Path):
    """Without it they would be compared on what each was trained on."""
    runs = make_run("flat", get_task("flat")), make_run("uneven", get_task("uneven"), seed=1)
    with pytest.raises(UserError, match="different ground; say with --task"):
        main(options(tmp_path / "out", *runs, protocol="transition"))
    main(options(tmp_path / "out", *runs, protocol="transition", task="flat"))
    assert len(worlds) == 1 and worlds[0].ground.height_range == 0.0
    assert [path.name for path in draw_all([tmp_path / "out"], tmp_path)] == [
        "figure_4_ai_cpg.png",
        "figure_6.png",
    ]
