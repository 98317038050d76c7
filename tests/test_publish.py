"""Shipping a checkpoint."""

from pathlib import Path

import pytest
import torch
import yaml

from aicpg_newton import checkpoint
from aicpg_newton.errors import UserError
from aicpg_newton.publish import PublishOptions, publish


def test_published_checkpoints_play_but_have_no_optimiser(tmp_path: Path):
    """Networks stay bit for bit, the optimiser goes, and the configuration says how long it was trained."""
    run = tmp_path / "run"
    run.mkdir()
    networks = {"actor_state_dict": {"w": torch.rand(5)}, "critic_state_dict": {"w": torch.rand(5)}}
    for iteration in (2, 9):
        checkpoint.write(
            run / f"model_{iteration}.pt",
            task={"name": "flat"},
            pattern={"format": 1},
            run={"seed": 0},
            iteration=iteration,
            samples=100 * iteration,
            algorithm={**networks, "optimizer_state_dict": {"state": torch.rand(1000)}},
        )
    options = PublishOptions(checkpoint=run, out=tmp_path / "policies")
    with pytest.raises(UserError, match=r"config\.yaml"):
        publish(options)
    (run / "config.yaml").write_text("run: {seed: 0}\n")
    target = publish(options)
    content = checkpoint.read(target)
    assert target.name == "flat.pt"
    assert content["iteration"] == 9
    assert content["algorithm"].keys() == networks.keys()
    assert torch.equal(content["algorithm"]["actor_state_dict"]["w"], networks["actor_state_dict"]["w"])
    config = yaml.safe_load(target.with_suffix(".yaml").read_text())
    assert config == {"run": {"seed": 0}, "trained": {"iterations": 9, "samples": 900}}


def test_no_policy_for_an_unknown_task():
    """The message says what to do."""
    with pytest.raises(UserError, match="no trained policy ships for task 'moon'"):
        checkpoint.shipped("moon")
