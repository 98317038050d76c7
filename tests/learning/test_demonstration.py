"""What a training shows of itself: measures by hand, films, and that it does not disturb."""

import io
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import pytest
import torch
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from aicpg_newton.env.registry import get_task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import checkpoint, demonstration, work
from aicpg_newton.learning.demonstration import ROBOTS, Demonstration, as_gif
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.training import train


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Demonstrations of two seconds."""
    monkeypatch.setattr(demonstration, "DURATION", 2.0)


def no_action(observed) -> torch.Tensor:
    """The CPG alone."""
    return torch.zeros(len(observed["policy"]), 28)


def test_a_trained_network_walks_and_runs(pattern: PatternNetwork, tmp_path: Path, short):
    """All stand, the run is faster and flies, the walk does not; every second time there are two films of 60 frames."""
    trained = checkpoint.read(checkpoint.shipped("robust"))
    show = Demonstration(get_task("flat"), pattern, tmp_path)
    runner = Runner(show._trial.environment(), trained["run"])
    runner.take_networks(trained, "actor")
    state = torch.random.get_rng_state()
    measures = show(runner.decide)
    assert torch.equal(torch.random.get_rng_state(), state)
    assert measures["Demonstration/0.9_Hz_stand"] == measures["Demonstration/1.3_Hz_stand"] == 1.0
    assert 1.0 < measures["Demonstration/0.9_Hz_speed"] < 1.9 < 2.5 < measures["Demonstration/1.3_Hz_speed"] < 4.0
    assert measures["Demonstration/0.9_Hz_flight"] < 0.02 < 0.2 < measures["Demonstration/1.3_Hz_flight"] < 0.5
    assert show(runner.decide) == measures
    films = show.film(100)
    assert films == sorted((tmp_path / "films").iterdir())
    assert [film.name for film in films] == ["000100_0.9_Hz.mp4", "000100_1.3_Hz.mp4"]
    assert imageio_ffmpeg.count_frames_and_secs(str(films[0]))[0] == 60
    picture = Image.open(io.BytesIO(as_gif(films[0])))
    assert (picture.size, getattr(picture, "n_frames", 1)) == ((256, 144), 20)


def test_what_happens_after_a_fall_does_not_count(pattern: PatternNetwork, tmp_path: Path, short):
    """The CPG alone falls: nobody stands at the end, and the speed is that before."""
    measures = Demonstration(get_task("flat"), pattern, tmp_path)(no_action)
    assert measures["Demonstration/1.3_Hz_stand"] < 0.5
    assert measures["Demonstration/1.3_Hz_speed"] > 0.3
    assert not (tmp_path / "films").exists()


def test_a_baseline_has_one_gait(pattern: PatternNetwork, tmp_path: Path, short):
    """No frequency sets it, so that all robots are alike and one is filmed."""
    show = Demonstration(get_task("flat", "ppo:2.0"), pattern, tmp_path)
    measures = show(no_action)
    assert set(measures) == {f"Demonstration/all_{name}" for name in ("stand", "speed", "flight")}
    standing = 2 * ROBOTS * measures["Demonstration/all_stand"]
    assert standing == pytest.approx(round(standing))
    assert [film.name for film in show.film(7)] == ["000007_all.mp4"]


@pytest.mark.parametrize("logger", ["tensorboard", "none"])
def test_a_training_shows_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, logger: Any):
    """Curves at every checkpoint, films at every second, in TensorBoard too; without a log there are films alone."""
    monkeypatch.setattr(demonstration, "DURATION", 0.2)
    monkeypatch.setattr(work, "Demonstration", Demonstration)
    task = get_task("flat")
    task.learning.hidden_sizes, task.learning.steps_per_iteration, task.learning.save_interval = (16,), 4, 1
    options = RunOptions(num_envs=4, device="cpu", max_iterations=5, run_dir=tmp_path, film_every=2, logger=logger)
    assert train(task, options).name == "model_4.pt"
    names = [f"{iteration:06d}_{gait}_Hz.mp4" for iteration in (2, 4) for gait in (0.9, 1.3)]
    assert sorted(film.name for film in (tmp_path / "films").iterdir()) == names
    events = EventAccumulator(str(tmp_path)).Reload()
    if logger == "none":
        assert not list(tmp_path.glob("events*"))
        return
    assert [event.step for event in events.Scalars("Demonstration/0.9_Hz_stand")] == [1, 2, 3, 4]
    shown = events.Images("Demonstration/1.3_Hz")
    assert [event.step for event in shown] == [2, 4] and shown[0].encoded_image_string.startswith(b"GIF89a")
