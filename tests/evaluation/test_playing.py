"""Playing agents: table, filmstrip, recording, and clear words about bad options."""

import math
from pathlib import Path

import imageio_ffmpeg
import pytest
import torch
from PIL import Image

from aicpg_newton.cpg import PatternNetwork
from aicpg_newton.errors import UserError
from aicpg_newton.evaluation.playing import PlayOptions, play
from aicpg_newton.evaluation.rollout import Tally, kinematic_frames
from aicpg_newton.learning.training import RunOptions, train
from tasks import get_task


def test_tally_counts_way_falls_and_episodes():
    """Two environments at 1 Hz and one at 1.2 Hz over 2 s; the first falls once."""
    tally = Tally(torch.tensor([1.0, 1.0, 1.2]))
    for step in range(120):
        tally.add(torch.tensor([1.0, 2.0, 3.0]), torch.tensor([step == 60, False, False]))
    assert tally.distance.tolist() == pytest.approx([2.0, 4.0, 6.0], rel=1e-4)
    lines = tally.table().splitlines()
    assert lines[1].split() == ["1.00", "2", "1.50", "1", "1.3"]
    assert lines[2].split() == ["1.20", "1", "3.00", "0", "2.0"]


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
    tally = play(PlayOptions(agent=agent, num_envs=3, duration=2.0, device="cpu"), get_task("flat"))
    assert tally.steps == 120
    assert tally.falls.sum() >= 1
    assert "falls" in capsys.readouterr().out


def test_a_checkpoint_plays_with_its_own_task(tmp_path: Path, capsys: pytest.CaptureFixture):
    """What train writes, play reads, on both engines, with the frequencies asked for."""
    task = get_task("flat")
    task.learning.hidden_sizes = (16,)
    last = train(task, RunOptions(num_envs=4, device="cpu", max_iterations=1, run_dir=tmp_path / "run"))
    speeds = []
    for engine in ("mujoco", "newton"):
        options = PlayOptions(
            checkpoint=last, frequency=(1.0,), num_envs=2, duration=0.4, device="cpu", engine=engine, seed=4
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
        options = PlayOptions(frequency=(0.9, 1.3), num_envs=num_envs, duration=5.0, device="cpu", engine=engine)
        tally = play(options, get_task("flat"))
        slow, fast = tally.distance[: num_envs // 2].mean() / 5.0, tally.distance[num_envs // 2 :].mean() / 5.0
        assert tally.falls.sum() == 0
        assert 1.2 < slow < 2.0
        assert 3.0 < fast < 4.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
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
        play(PlayOptions(**{"device": "cpu", **changes}), get_task("flat"))
