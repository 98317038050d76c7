"""Settings as plain data and back, those of earlier versions included."""

from typing import Any

import pytest
import torch
import yaml

from aicpg_newton.env.methods import METHODS, get_method
from aicpg_newton.env.registry import TASKS, get_task, task_from_dict
from aicpg_newton.env.rewards import RewardTerm
from aicpg_newton.env.stored import plain, to_dict
from aicpg_newton.env.task import ImitationTask, ReflexTask, SpeedTask
from aicpg_newton.errors import UserError
from aicpg_newton.learning import checkpoint
from aicpg_newton.places import ASSETS


@pytest.mark.parametrize("method", METHODS)
def test_round_trip_through_a_dictionary(method: str):
    """A changed task comes back equal, tuples and parameters included, and holds nothing but plain data."""
    task = get_task("uneven", method)
    task.learning.hidden_sizes = (64, 32)
    task.rewards["upright"].weight = 2.5
    if method == "ai-cpg":
        task.rewards["pattern_tracking"].parameters = {"bound": 2.5, "reading": "magnitude_of_sum"}
    content = to_dict(task)
    assert task_from_dict(yaml.safe_load(yaml.safe_dump(plain(content))), "file") == task


def test_a_registered_task_gives_the_functions(monkeypatch: pytest.MonkeyPatch):
    """What a checkpoint holds of a term are its numbers; without the task that brings it, the term is unknown."""

    def thought_of():
        task = TASKS["flat"]()
        task.name = "mine"
        task.rewards["one"] = RewardTerm(lambda view, size: torch.ones(1) * size, 1.0, {"size": 2.0})
        return task

    monkeypatch.setitem(TASKS, "mine", thought_of)
    task = get_task("mine")
    task.rewards["one"].weight = task.rewards["one"].parameters["size"] = 3.0
    content = to_dict(task)
    found = task_from_dict(content, "file").rewards["one"]
    assert (found.weight, found.parameters) == (3.0, {"size": 3.0})
    monkeypatch.delitem(TASKS, "mine")
    with pytest.raises(UserError, match=r"file holds settings of another version \(rewards: one\)"):
        task_from_dict(content, "file")


def stored(task: str = "flat", /, **changes: Any) -> dict[str, Any]:
    """Content of a task with some settings changed, given by dotted name with two underscores for a dot."""
    content = to_dict(get_task(task))
    for path, value in changes.items():
        *parents, last = path.split("__")
        owner = content
        for parent in parents:
            owner = owner[parent]
        owner[last] = value
    return content


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (stored(reflex__gain=3.0), "ReflexTask|Reflex: gain"),
        (stored(name=None), "holds no task of this version"),
        (None, "holds no task of this version"),
        (stored(reflex__torque_share="much"), "'much' for torque_share"),
        (stored(learning__network="transformer"), "'transformer' for network"),
        (stored(rewards__upright=2.0), "RewardTerm: no settings"),
        (stored(rewards__upright__weight="much"), "'much' for weight"),
        (stored(rewards__pattern_tracking__parameters={"bound": "wide"}), "'wide' for bound"),
        (stored(rewards__pattern_tracking__parameters={"width": 1.0}), "parameters: width"),
        (stored(target_speed=1.0), "ReflexTask: target_speed"),
        (stored(learning=None), "Learning: no settings"),
    ],
)
def test_settings_of_another_version_are_refused(content: Any, message: str):
    """An unknown setting is named, and so are a missing name and a wrong value."""
    with pytest.raises(UserError, match=message):
        task_from_dict(content, "file")


def test_a_reward_term_from_later_had_no_weight(monkeypatch: pytest.MonkeyPatch):
    """A training of before the task had it goes on with the reward that it had."""
    plain_task = TASKS["flat"]

    def with_one_more():
        task = plain_task()
        task.rewards["later"] = RewardTerm(lambda view, size: torch.ones(1) * size, 1.0, {"size": 2.0})
        return task

    content = to_dict(get_task("flat"))
    content["rewards"]["upright"]["weight"] = 2.0
    monkeypatch.setitem(TASKS, "flat", with_one_more)
    task = task_from_dict(content, "file")
    assert (task.rewards["later"].weight, task.rewards["later"].parameters) == (0.0, {"size": 2.0})
    assert task.rewards["upright"].weight == 2.0 and get_task("flat").rewards["later"].weight == 1.0


def test_reward_terms_that_are_gone_are_left_out():
    """Of a task that had them: it can be read."""
    content = to_dict(get_task("robust"))
    for name in ("sideways_speed", "turned_away", "bounce"):
        content["rewards"][name] = {"weight": -1.0, "parameters": {}}
    assert task_from_dict(content, "file") == get_task("robust")


def test_settings_that_are_not_there_are_the_tasks_own():
    """Except for those that meant something else before they were settings."""
    content = stored("uneven")
    del content["ground"], content["learning"]["learn_std"]
    found = task_from_dict(content, "file")
    assert found == get_task("uneven")
    del content["learning"]["value_clipping"]
    assert task_from_dict(content, "file").learning.value_clipping is True


@pytest.mark.parametrize(("was", "now"), [(True, "minibatch"), (False, "fixed")])
def test_settings_from_before_mean_what_they_meant(was: bool, now: str):
    """A checkpoint of the first version learns on as it did: ordinary networks, rsl_rl's schedule and its bounds."""
    content = stored()
    learning = content["learning"]
    bounds = ("minimum_learning_rate", "maximum_learning_rate")
    for name in ("learning_rate_schedule", "network", "critic_hidden_sizes", *bounds):
        del learning[name]
    learning["adaptive_learning_rate"] = was
    found = task_from_dict(content, "file").learning
    assert (found.network, found.learning_rate_schedule) == ("mlp", now)
    assert (found.minimum_learning_rate, found.maximum_learning_rate) == (1e-5, 1e-2)
    assert found.critic_hidden_sizes == ()


def test_trainings_from_before_gears_keep_their_unit():
    """Torques in units of the limit, velocities in units of 10 rad/s; a baseline without a reflex has no unit."""
    content = to_dict(get_task("flat"))
    del content["reflex"]["unit"], content["rewards"]["action_energy"]["parameters"]
    task = task_from_dict(content, "file")
    assert isinstance(task, ReflexTask) and task.reflex.unit == "limit"
    assert task.rewards["action_energy"].parameters == {"velocity_scale": 0.1}
    imitation = to_dict(get_task("flat", "amp"))
    del imitation["rewards"]["action_energy"]["parameters"]
    assert task_from_dict(imitation, "file").rewards["action_energy"].parameters == {"velocity_scale": 0.1}


@pytest.mark.parametrize("path", sorted((ASSETS / "policies").glob("*.pt")), ids=lambda path: path.stem)
def test_shipped_checkpoints_keep_their_settings(path):
    """Weights, parameters and scale of the reward are where they are today; what the method does not have is gone."""
    content = checkpoint.read(path)["task"]
    task = task_from_dict(content, path.name)
    task.validate()
    assert isinstance(task, get_method(task.method).task)
    if "weights" in content["rewards"]:
        before = {**content["rewards"]["weights"]}
        before["action_energy"] = before.pop("reflex_energy")
        assert {name: term.weight for name, term in task.rewards.items()} == {
            name: before.get(name, 0.0) for name in task.rewards
        }
        assert task.learning.reward_scale == content["rewards"]["scale"]
        if "pattern_tracking" in task.rewards:
            assert task.rewards["pattern_tracking"].parameters["bound"] == content["rewards"]["pattern_error_bound"]
    if isinstance(task, ReflexTask):
        assert task.reflex.unit == content["reflex"].get("unit", "limit")
    if isinstance(task, SpeedTask):
        assert task.target_speed == content["target_speed"]
    if isinstance(task, ImitationTask):
        assert task.reference == content["reference"]
        assert task.imitation.replay_size == content["imitation"]["replay_size"]
        assert task.drives == content.get("drives", "pattern")
        assert task.imitation.loss == content["imitation"].get("loss", "least_squares")
