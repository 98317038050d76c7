"""Options of a training: what they come to, and what is refused before anything is built or written."""

from dataclasses import replace
from pathlib import Path

import pytest

from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import ReflexTask
from aicpg_newton.errors import UserError
from aicpg_newton.learning import checkpoint, plan
from aicpg_newton.learning.plan import RunOptions, task_of, with_networks_of
from aicpg_newton.learning.training import train


def test_a_new_run_builds_its_networks_as_those_it_begins_with():
    """That network is of the first version, an ordinary one with torques in units of the limit; the rest is today's."""
    plain = get_task("flat")
    found, own = (with_networks_of(plain, checkpoint.shipped("uneven")), task_of(checkpoint.shipped("uneven")))
    assert isinstance(plain, ReflexTask) and isinstance(found, ReflexTask) and isinstance(own, ReflexTask)
    assert found.learning.network == own.learning.network
    assert found.learning.hidden_sizes == own.learning.hidden_sizes
    assert found.learning.reward_scale == own.learning.reward_scale == 0.1  # the critic's unit
    assert found.reflex == own.reflex and own.reflex.unit == "limit" != plain.reflex.unit
    names = ("network", "hidden_sizes", "activation", "reward_scale")
    kept = {name: getattr(plain.learning, name) for name in names}
    assert replace(found, learning=replace(found.learning, **kept), reflex=plain.reflex) == plain


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_envs": 0}, "--num-envs is 0"),
        ({"max_iterations": 0}, "--max-iterations is 0"),
        ({"max_minutes": 0.0}, "--max-minutes is 0"),
        ({"start_from": Path("nowhere.pt")}, "no checkpoint at nowhere.pt"),
        ({"engine": "bullet"}, "bullet"),
        ({"learner_device": "cuda:0", "engine": "newton"}, "goes with --engine mujoco"),
        ({"learner_device": "cuda:99"}, "'cuda:99' is not there"),
        ({"pattern": Path("nowhere.pt")}, "no pattern network at nowhere.pt"),
        ({"resume": Path("nowhere.pt")}, "no checkpoint at nowhere.pt"),
    ],
)
def test_bad_options(tmp_path: Path, changes: dict, message: str):
    """One sentence each, and no run folder is left."""
    with pytest.raises(UserError, match=message):
        train(get_task("flat"), RunOptions(**{"device": "cpu", "run_dir": tmp_path / "never", **changes}))
    assert not (tmp_path / "never").exists()


def test_a_logger_that_is_not_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """One sentence says what to install, before anything is written."""
    monkeypatch.setattr(plan, "find_spec", lambda name: None)
    with pytest.raises(UserError, match="pip install wandb"):
        train(get_task("flat"), RunOptions(device="cpu", logger="wandb", run_dir=tmp_path / "run"))
    assert not (tmp_path / "run").exists()
