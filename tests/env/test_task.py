"""Tasks as data."""

import dataclasses

import pytest

from aicpg_newton.env.task import Task, task_from_dict
from aicpg_newton.errors import UserError
from tasks import TASKS, get_task


@pytest.mark.parametrize("name", TASKS)
def test_registered_tasks_are_valid_and_carry_their_name(name: str):
    """The registry's name is the task's name, and its settings can be run."""
    task = get_task(name)
    assert task.name == name
    task.validate()


def test_flat_has_the_papers_numbers():
    """Eq. 5-8 and Sec. III-A, where the paper gives numbers."""
    task = get_task("flat")
    weights = task.rewards.weights
    assert (weights.head_height, weights.survival, weights.upright, weights.target_velocity) == (1, 1, 1, 1)
    assert (weights.reflex_energy, weights.pattern_tracking) == (-0.5, 5.0)
    assert (task.frequencies.minimum, task.frequencies.maximum) == (0.8, 1.4)
    assert task.learning.hidden_sizes == (512, 256, 128)
    assert task.learning.activation == "relu"


def test_unknown_task():
    """The message lists the choices."""
    with pytest.raises(UserError, match=r"unknown task 'hill'; choose one of: flat"):
        get_task("hill")


def test_round_trip_through_a_dictionary():
    """A changed task comes back equal, tuples included."""
    task = get_task("flat")
    task.learning.hidden_sizes = (64, 32)
    task.rewards.weights.upright = 2.5
    assert task_from_dict(dataclasses.asdict(task), "file") == task


def test_settings_of_another_version_are_refused():
    """An unknown setting is named, and so are a missing name and a wrong value; other settings have defaults."""
    content = dataclasses.asdict(get_task("flat"))
    content["reflex"]["gain"] = 3.0
    with pytest.raises(UserError, match="Reflex: gain"):
        task_from_dict(content, "file")
    content = dataclasses.asdict(get_task("flat"))
    del content["name"]
    with pytest.raises(UserError, match="Task: name"):
        task_from_dict(content, "file")
    content = dataclasses.asdict(get_task("uneven"))
    del content["ground"], content["learning"]["learn_std"]
    assert task_from_dict(content, "file").ground.height_range == 0.0
    assert task_from_dict(content, "file").learning.value_clipping is False
    del content["learning"]["value_clipping"]  # it was on before it was a setting
    assert task_from_dict(content, "file").learning.value_clipping is True
    content = dataclasses.asdict(get_task("flat"))
    content["reference"] = "hop"
    with pytest.raises(UserError, match="'hop' for reference"):
        task_from_dict(content, "file")
    content = dataclasses.asdict(get_task("flat"))
    content["reflex"]["torque_share"] = "much"
    with pytest.raises(UserError, match="torque_share"):
        task_from_dict(content, "file")


@pytest.mark.parametrize(("was", "now"), [(True, "minibatch"), (False, "fixed")])
def test_settings_from_before_mean_what_they_meant(was: bool, now: str):
    """A checkpoint of the first version learns on as it did: ordinary networks, rsl_rl's schedule and its bounds."""
    content = dataclasses.asdict(get_task("flat"))
    learning = content["learning"]
    bounds = ("minimum_learning_rate", "maximum_learning_rate")
    for name in ("learning_rate_schedule", "network", "critic_hidden_sizes", *bounds):
        del learning[name]
    learning["adaptive_learning_rate"] = was
    found = task_from_dict(content, "file").learning
    assert (found.network, found.learning_rate_schedule) == ("mlp", now)
    assert (found.minimum_learning_rate, found.maximum_learning_rate) == (1e-5, 1e-2)
    assert found.critic_hidden_sizes == ()


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("frequencies.minimum", 0.0, "frequencies run from 0.0"),
        ("frequencies.minimum", 1.5, "frequencies run from 1.5"),
        ("rewards.weights.upright", float("nan"), "rewards.weights.upright is nan"),
        ("rewards.pattern_error_bound", 0.0, "rewards.pattern_error_bound is 0.0"),
        ("physics.substeps", 3, "physics.substeps is 3"),
        ("physics.iterations", 0, "physics.iterations is 0"),
        ("learning.minibatches", 0, "learning.minibatches is 0"),
        ("learning.hidden_sizes", (), "learning.hidden_sizes is 0"),
        ("learning.learning_rate", -1.0, "learning.learning_rate is -1"),
        ("learning.learning_rate", 0.1, "learning.learning_rate is 0.1, outside of its bounds"),
        ("learning.maximum_learning_rate", 1e-6, "outside of its bounds"),
        ("learning.minimum_learning_rate", 0.0, "learning.minimum_learning_rate is 0.0"),
        ("learning.critic_hidden_sizes", (0,), "learning.critic_hidden_sizes is 0"),
        ("learning.discount", 2.0, "learning.discount is 2.0"),
        ("resets.minimum_speed", 3.0, "start speeds run from 3.0"),
        ("termination.maximum_tilt", float("inf"), "termination.maximum_tilt is inf"),
    ],
)
def test_bad_settings_are_named(path: str, value: object, message: str):
    """A setting that cannot be run is refused by its name."""
    task = get_task("flat")
    *parents, last = path.split(".")
    owner: object = task
    for parent in parents:
        owner = getattr(owner, parent)
    setattr(owner, last, value)
    with pytest.raises(UserError, match=message):
        task.validate()


def test_layers_of_an_equivariant_network_have_two_halves():
    """An odd width is refused; an ordinary network takes it."""
    task = get_task("flat")
    task.learning.hidden_sizes = (64, 33)
    task.learning.network = "equivariant"
    with pytest.raises(UserError, match="one has 33 units"):
        task.validate()
    task.learning.network = "mlp"
    task.validate()


def test_every_setting_has_a_help_text():
    """Fields of the task are documented where they stand; tyro shows the docstrings."""
    import inspect

    from aicpg_newton.env import task

    source = inspect.getsource(task)
    for each in vars(task).values():
        if (
            dataclasses.is_dataclass(each)
            and each is not Task
            and isinstance(each, type)
            and each.__module__ == task.__name__
        ):
            for setting in dataclasses.fields(each):
                after = source.split(f"    {setting.name}: ", 1)[1].split("\n", 2)[1]
                assert after.strip().startswith('"""'), setting.name
