"""Playing agents: table, filmstrip, recording, and clear words about bad options."""

import math
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import pytest
import torch
from PIL import Image

from aicpg_newton.env import environment
from aicpg_newton.env.environment import engine_for
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.training import train
from aicpg_newton.playing import options as options_module
from aicpg_newton.playing import outputs
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.play import play
from aicpg_newton.playing.rollout import Tally, kinematic_frames
from aicpg_newton.viewing.desk import Turn
from aicpg_newton.viewing.filmstrip import TILE_HEIGHT


def small(name: str, method: str = "ai-cpg") -> Task:
    """A task with a small network, and with a small piece of ground where that is uneven."""
    task = get_task(name, method)
    task.learning.hidden_sizes = (16,)
    task.ground.length, task.ground.width = 24.0, 16.0
    return task


def trained(folder: Path, task: Task) -> Path:
    """A checkpoint after one iteration."""
    return train(task, RunOptions(num_envs=4, device="cpu", max_iterations=1, run_dir=folder / "run"))


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[Task]:
    """The tasks that engines are made for."""
    tasks: list[Task] = []

    def noted(task: Task, *arguments):
        tasks.append(task)
        return engine_for(task, *arguments)

    monkeypatch.setattr(environment, "engine_for", noted)
    return tasks


def test_tally_counts_way_falls_and_episodes():
    """Two environments at 1 Hz and one at 1.2 Hz over 2 s; the first falls once, the last turns away once."""
    tally = Tally(torch.tensor([1.0, 1.0, 1.2]))
    for step in range(120):
        fallen, turned = torch.tensor([step == 60, False, False]), torch.tensor([False, False, step == 70])
        tally.add(torch.tensor([1.0, 2.0, 3.0]), fallen, turned)
    assert tally.distance.tolist() == pytest.approx([2.0, 4.0, 6.0], rel=1e-4)
    lines = tally.table().splitlines()
    assert lines[1].split() == ["1.00", "2", "1.50", "1", "0", "1.3"]
    assert lines[2].split() == ["1.20", "1", "3.00", "0", "1", "1.0"]


def test_table_of_a_network_without_frequency():
    """It has one line, aligned like the others, that names no frequency."""
    tally = Tally(torch.ones(3), follows_frequency=False)
    tally.add(torch.ones(3), torch.tensor([False, False, True]), torch.zeros(3, dtype=torch.bool))
    head, line = tally.table().splitlines()
    assert line.split()[:2] == ["-", "3"]
    assert len(line) == len(head)


def test_kinematic_playback_moves_at_the_gaits_speed(pattern: PatternNetwork):
    """One second at the walk's frequency: the walk's speed, its phase and no falls."""
    walk = pattern.gaits[0]
    frequency = torch.tensor([walk.frequency])
    tally = Tally(frequency)
    frames = list(kinematic_frames(pattern, frequency, 60, tally))
    way = frames[-1].root_position[0, 0] - frames[0].root_position[0, 0]
    assert float(way) == pytest.approx(walk.speed * 59 / 60, abs=0.06)
    assert float(frames[-1].phase) == pytest.approx(2 * math.pi * walk.frequency, abs=1e-3)
    assert tally.falls.sum() == 0


def test_mocap_agent_makes_pictures(tmp_path: Path, capsys: pytest.CaptureFixture):
    """A filmstrip with a row per frequency and a recording with 30 frames per second."""
    strip, film = tmp_path / "strip.png", tmp_path / "film.mp4"
    options = PlayOptions(
        agent="mocap", frequency=(0.9, 1.3), num_envs=2, duration=2.5, device="cpu", filmstrip=strip, record=film
    )
    play(options, get_task("flat"))
    width, height = Image.open(strip).size
    assert width > 8 * 150 and height == 2 * 240
    assert imageio_ffmpeg.count_frames_and_secs(str(film))[0] == pytest.approx(75, abs=1)
    out = capsys.readouterr().out
    assert "speed [m/s]" in out and "0.90" in out and "1.30" in out


@pytest.mark.parametrize("agent", ["zero", "random"])
def test_agents_without_a_checkpoint(agent, capsys: pytest.CaptureFixture):
    """They fall, and the table says so."""
    tally = play(PlayOptions(agent=agent, num_envs=3, duration=2.0, device="cpu", viewer="none"), get_task("flat"))
    assert tally.steps == 120
    assert tally.falls.sum() >= 1
    assert "falls" in capsys.readouterr().out


def test_a_live_viewer_runs_until_it_is_interrupted(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture):
    """For an hour if nothing else is said; Ctrl-C ends it with the table, and a hint if f was turned."""

    class Watcher:
        """Somebody who turns f at once and presses Ctrl-C in the third step."""

        def __init__(self, *arguments) -> None:
            self.desk, self.steps = arguments[-1], 0

        def __enter__(self):
            return self

        def __exit__(self, *_) -> None:
            pass

        def is_running(self) -> bool:
            return True

        def show(self, *_) -> None:
            self.desk.ask(Turn(1.0))
            self.steps += 1
            if self.steps == 3:
                raise KeyboardInterrupt

    monkeypatch.setattr(outputs, "LiveViewer", Watcher)
    options = PlayOptions(agent="zero", num_envs=3, viewer="viser", device="cpu")
    assert options.steps() == 3600 * 60
    assert replace(options, viewer="none").steps() == replace(options, record=Path("a.mp4")).steps() == 600
    assert (options.robots, replace(options, num_envs=None).robots) == (3, 3)
    assert replace(options, num_envs=None, frequency=(1.0,)).robots == 1
    assert play(options, get_task("flat")).steps == 3
    printed = capsys.readouterr().out
    assert "turned by hand" in printed and "speed [m/s]" in printed


def test_without_a_word_it_shows_itself(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys):
    """The page where there is a screen; a recording under a free name where there is none, or no package."""
    monkeypatch.chdir(tmp_path)
    screen, missing = [True], [[]]
    monkeypatch.setattr(options_module, "has_screen", lambda: screen[0])
    monkeypatch.setattr(options_module, "missing_packages", lambda kind: missing[0])
    assert PlayOptions().settled().viewer == "viser"
    missing[0] = ["viser"]
    assert PlayOptions().settled().record == Path("play.mp4")
    assert "pip install viser" in capsys.readouterr().out
    screen[0] = False
    Path("play.mp4").touch()
    settled = PlayOptions().settled()
    assert (settled.viewer, settled.record, settled.robots) == ("none", Path("play_2.mp4"), 12)
    strip = PlayOptions(filmstrip=Path("a.png")).settled()
    assert (strip.viewer, strip.record) == ("none", None)
    assert PlayOptions(viewer="none").settled().record is None


def test_a_checkpoint_plays_with_its_own_task(tmp_path: Path, capsys: pytest.CaptureFixture):
    """What train writes, play reads, on both engines, with the frequencies asked for."""
    task = small("flat")
    last = trained(tmp_path, task)
    speeds = []
    for engine in ("mujoco", "newton"):
        options = PlayOptions(
            checkpoint=last,
            frequency=(1.0,),
            num_envs=2,
            duration=0.4,
            device="cpu",
            engine=engine,
            seed=4,
            viewer="none",
        )
        tally = play(options, task)
        speeds.append(tally.distance)
        assert tally.frequency.tolist() == [1.0, 1.0]
    # The same network from the same start on both engines, for 0.4 s.
    assert torch.allclose(speeds[0], speeds[1], atol=0.02)
    assert "1.00" in capsys.readouterr().out


def test_the_shipped_network_walks_and_runs_on_both_engines(capsys: pytest.CaptureFixture):
    """Without a checkpoint the shipped one plays: in 5 s nobody falls at 0.9 and 1.3 Hz, and f sets the speed."""
    for engine, num_envs in (("mujoco", 16), ("newton", 4)):
        options = PlayOptions(frequency=(0.9, 1.3), num_envs=num_envs, duration=5.0, engine=engine, viewer="none")
        tally = play(options, get_task("flat"))
        slow, fast = tally.distance[: num_envs // 2].mean() / 5.0, tally.distance[num_envs // 2 :].mean() / 5.0
        assert tally.falls.sum() == 0
        assert 1.0 < slow < 2.0
        assert 2.5 < fast < 4.5


def test_the_shipped_network_plays_on_uneven_ground(tmp_path: Path, played: list[Task]):
    """On the other task's ground, of a seed that no training takes, with its own settings; a filmstrip shows it."""
    strip = tmp_path / "strip.png"
    options = PlayOptions(
        checkpoint=checkpoint.shipped("flat"),
        task="uneven",
        frequency=(1.3,),
        num_envs=2,
        duration=2.0,
        device="cpu",
        filmstrip=strip,
    )
    tally = play(options, small("uneven"))
    assert 1.2 < float(tally.distance[0]) / 2.0 < 4.5
    (task,) = played
    assert (task.name, task.learning.hidden_sizes) == ("uneven", (512, 256, 128))
    assert (task.ground.height_range, task.ground.seed, task.ground.length) == (0.1, 1000, 24.0)
    assert Image.open(strip).size[1] == TILE_HEIGHT


def test_a_checkpoint_of_uneven_ground_plays_without_its_curriculum(tmp_path: Path, played: list[Task]):
    """It keeps its own ground, at full height everywhere, of the seed asked for; the CPG alone plays on it as well."""
    uneven = small("uneven")
    uneven.ground.levels = 2
    last, film = trained(tmp_path, uneven), tmp_path / "film.mp4"
    for agent in ("policy", "zero"):
        options = PlayOptions(
            checkpoint=last, agent=agent, terrain_seed=7, frequency=(1.0,), num_envs=2, duration=0.1, device="cpu"
        )
        play(replace(options, record=film), get_task("flat"))
    for task in played:
        assert (task.name, task.ground.levels, task.ground.seed) == ("uneven", 1, 7)
    assert len(played) == 2 and uneven.ground.levels == 2
    assert film.stat().st_size > 1000


@pytest.mark.parametrize(("method", "title"), [("ppo:2.0", "PPO 2.0"), ("amp:run", "AMP run")])
def test_methods_without_frequency(tmp_path: Path, capsys: pytest.CaptureFixture, played: list[Task], method, title):
    """They play as one condition; asked for a frequency, they say that it does nothing; a filmstrip takes a second."""
    last = trained(tmp_path, small("flat", method))
    options = PlayOptions(checkpoint=last, num_envs=2, duration=0.2, device="cpu", record=tmp_path / "film.mp4")
    capsys.readouterr()
    tally = play(options, get_task("flat"))
    out = capsys.readouterr().out
    assert out.splitlines()[-1].split()[:2] == ["-", "2"]
    assert len(tally.table().splitlines()) == 2
    assert played[0].method == method.partition(":")[0]
    with pytest.raises(UserError, match="no robot did a whole stride"):
        play(replace(options, record=None, filmstrip=tmp_path / "strip.png"), get_task("flat"))
    with pytest.raises(UserError, match=rf"--frequency does nothing to a network trained as {title}"):
        play(PlayOptions(checkpoint=last, frequency=(0.9,), viewer="none"), get_task("flat"))
    # The gait that it was trained with is played back at any frequency.
    assert play(
        PlayOptions(checkpoint=last, agent="mocap", duration=0.1, viewer="none"), get_task("flat")
    ).follows_frequency


def test_mocap_walks_on_a_plane_and_says_so(capsys: pytest.CaptureFixture, tmp_path: Path):
    """Without physics nothing would keep it on uneven ground."""
    strip = tmp_path / "strip.png"
    options = PlayOptions(agent="mocap", task="uneven", num_envs=3, duration=1.5, device="cpu", filmstrip=strip)
    play(options, get_task("uneven"))
    assert "on a plane" in capsys.readouterr().out
    assert Image.open(strip).size[1] == 3 * TILE_HEIGHT


def test_a_task_without_a_shipped_network(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """One sentence says what to give."""
    monkeypatch.setattr(checkpoint.places, "ASSETS", tmp_path)
    with pytest.raises(UserError, match="no trained policy ships for task 'uneven'"):
        play(PlayOptions(task="uneven", viewer="none"), get_task("uneven"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"agent": "zero", "terrain_seed": 3}, "ground of task 'flat' is a plane"),
        ({"terrain_seed": 0}, "ground of task 'flat' is a plane"),
        ({"checkpoint": Path("nowhere.pt")}, "no checkpoint at nowhere.pt"),
        ({"agent": "zero", "frequency": (0.0,)}, "--frequency"),
        ({"agent": "zero", "frequency": (float("nan"),)}, "--frequency"),
        ({"agent": "zero", "num_envs": 0}, "--num-envs is 0"),
        ({"agent": "zero", "num_envs": 2}, "for 3 frequencies"),
        ({"agent": "zero", "duration": 0.0}, "--duration"),
        ({"agent": "zero", "engine": "bullet"}, "bullet"),
        ({"agent": "mocap", "filmstrip": Path("strip.jpg")}, "png"),
        ({"agent": "mocap", "record": Path("no/such/folder/film.mp4")}, "folder"),
    ],
)
def test_bad_options(changes: dict, message: str):
    """One sentence each."""
    with pytest.raises(UserError, match=message):
        play(PlayOptions(**{"device": "cpu", "viewer": "none", **changes}), get_task("flat"))
