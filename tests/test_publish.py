"""Shipping a checkpoint."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import yaml

from aicpg_newton.env.registry import get_task
from aicpg_newton.env.stored import to_dict
from aicpg_newton.env.task import Learning
from aicpg_newton.errors import UserError
from aicpg_newton.learning import checkpoint
from aicpg_newton.publish import PublishOptions, publish
from aicpg_newton.robot import humanoid


def test_published_checkpoints_play_but_have_no_optimiser(tmp_path: Path):
    """Networks stay bit for bit, the optimiser goes, and the configuration says how long it was trained."""
    run = tmp_path / "run"
    run.mkdir()
    networks = {"actor_state_dict": {"w": torch.rand(5)}, "critic_state_dict": {"w": torch.rand(5)}}
    for iteration in (2, 9):
        checkpoint.write(
            run / f"model_{iteration}.pt",
            task=to_dict(replace(get_task("flat"), learning=Learning(hidden_sizes=(8, 4)))),
            pattern={"format": 1},
            observations=[],
            run={"seed": 0},
            iteration=iteration,
            samples=100 * iteration,
            algorithm={**networks, "optimizer_state_dict": {"state": torch.rand(1000)}, "replay": torch.rand(1000)},
        )
    target = publish(PublishOptions(checkpoint=run, out=tmp_path / "policies"))
    content = checkpoint.read(target)
    assert target.name == "flat.pt"
    assert content["iteration"] == 9
    assert content["algorithm"].keys() == networks.keys()
    assert torch.equal(content["algorithm"]["actor_state_dict"]["w"], networks["actor_state_dict"]["w"])
    config = yaml.safe_load(target.with_suffix(".yaml").read_text())
    assert config["task"].pop("learning")["hidden_sizes"] == [8, 4]
    assert config["task"].pop("name") == "flat"
    del config["task"]
    assert config == {
        "run": {"seed": 0},
        "humanoid": humanoid.version(),
        "trained": {"iterations": 9, "samples": 900},
    }


@pytest.mark.parametrize(
    ("choice", "name"), [("ai-cpg", "uneven.pt"), ("ppo:3.0", "uneven_ppo_3.0.pt"), ("amp:run", "uneven_amp_run.pt")]
)
def test_baselines_go_by_method_and_condition(tmp_path: Path, choice: str, name: str):
    """So that none takes the place of another."""
    checkpoint.write(
        tmp_path / "model_0.pt",
        task=to_dict(get_task("uneven", choice)),
        pattern={},
        observations=[],
        run={},
        iteration=1,
        samples=1,
        algorithm={"actor_state_dict": {}, "critic_state_dict": {}},
    )
    target = publish(PublishOptions(checkpoint=tmp_path, out=tmp_path / "policies"))
    assert target.name == name
    assert target.with_name(name.removesuffix(".pt") + ".yaml").is_file()


def test_no_policy_for_an_unknown_task():
    """The message says what to do."""
    with pytest.raises(UserError, match="no trained policy ships for task 'moon'"):
        checkpoint.shipped("moon")
