"""Tasks as data."""

import dataclasses
import typing

import pytest

from aicpg_newton.env.methods import METHODS
from aicpg_newton.env.registry import TASKS, get_task
from aicpg_newton.env.task import ImitationTask
from aicpg_newton.errors import UserError
from aicpg_newton.ranges import Range


@pytest.mark.parametrize("name", TASKS)
def test_registered_tasks_are_valid_and_carry_their_name(name: str):
    """The registry's name is the task's name, and its settings can be run."""
    task = get_task(name)
    assert task.name == name
    task.validate()


def test_flat_has_the_papers_numbers():
    """Eq. 5-8 and Sec. III-A, where the paper gives numbers."""
    task = get_task("flat")
    weights = {name: term.weight for name, term in task.rewards.items()}
    assert {weights.pop(name) for name in ("head_height", "survival", "upright", "target_velocity")} == {1.0}
    assert weights == {"action_energy": -0.5, "pattern_tracking": 5.0}
    assert task.rewards["pattern_tracking"].parameters == {"bound": 2.5, "reading": "sum_of_magnitudes"}
    assert task.termination.maximum_heading == 180.0 and task.undisturbed().termination.maximum_heading == 57.0
    assert (task.frequencies.minimum, task.frequencies.maximum) == (0.8, 1.4)
    assert task.learning.hidden_sizes == (512, 256, 128)
    assert task.learning.activation == "relu"


def test_unknown_task():
    """The message lists the choices."""
    with pytest.raises(UserError, match=r"unknown task 'hill'; choose one of: flat"):
        get_task("hill")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("frequencies.minimum", 0.0, "frequencies.minimum is 0.0; give a positive number of at most 10"),
        ("frequencies.minimum", 1.5, "frequencies run from 1.5"),
        ("rewards.upright.weight", float("nan"), "rewards.upright.weight is nan"),
        ("rewards.pattern_tracking.parameters.bound", 0.0, "rewards.pattern_tracking.bound is 0.0"),
        ("rewards.pattern_tracking.parameters.reading", "mean", "rewards.pattern_tracking.reading is 'mean'"),
        ("reflex.torque_share", 0.0, "reflex.torque_share is 0.0"),
        ("frequencies.change_interval", -1.0, "frequencies.change_interval is -1.0"),
        ("frequencies.jumps", 1.5, "frequencies.jumps is 1.5"),
        ("ground.levels", 3, "ground.levels is 3, but ground.height_range is 0"),
        ("ground.level_strip", True, "give the strips a height"),
        ("physics.substeps", 3, "physics.substeps is 3"),
        ("physics.iterations", 0, "physics.iterations is 0"),
        ("learning.minibatches", 0, "learning.minibatches is 0"),
        ("learning.hidden_sizes", (), "learning.hidden_sizes has 0 layers"),
        ("learning.learning_rate", -1.0, "learning.learning_rate is -1"),
        ("learning.learning_rate", 0.1, "learning.learning_rate is 0.1, outside of its bounds"),
        ("learning.maximum_learning_rate", 1e-6, "outside of its bounds"),
        ("learning.minimum_learning_rate", 0.0, "learning.minimum_learning_rate is 0.0"),
        ("learning.critic_hidden_sizes", (0,), "learning.critic_hidden_sizes is 0"),
        ("learning.discount", 2.0, "learning.discount is 2.0"),
        ("resets.minimum_speed", 3.0, "start speeds run from 3.0"),
        ("termination.maximum_tilt", float("inf"), "termination.maximum_tilt is inf"),
        ("termination.maximum_tilt", -3.0, "termination.maximum_tilt is -3.0; give a positive number of at most 180"),
        ("learning.hidden_sizes", (8, 10**9), "learning.hidden_sizes is 1000000000; give a number from 1 to 8192"),
        ("learning.hidden_sizes", (8,) * 17, "learning.hidden_sizes has 17 layers"),
        ("ground.seed", -1, "ground.seed is -1"),
    ],
)
def test_bad_settings_are_named(path: str, value: object, message: str):
    """A setting that cannot be run is refused by its name."""
    task = get_task("flat")
    *parents, last = path.split(".")
    owner: object = task
    for parent in parents:
        owner = owner[parent] if isinstance(owner, dict) else getattr(owner, parent)
    if isinstance(owner, dict):
        owner[last] = value
    else:
        setattr(owner, last, value)
    with pytest.raises(UserError, match=message):
        task.validate()


def test_settings_of_a_baseline_have_ranges_too():
    """Shares, sizes, speeds."""
    task = get_task("flat", "amp:run")
    task.imitation.replay_keep = 5.0  # type: ignore[attr-defined]
    with pytest.raises(UserError, match=r"imitation.replay_keep is 5.0; give a number from 0 to 1"):
        task.validate()
    with pytest.raises(UserError, match=r"target_speed is -1.0; give a positive number of at most 20"):
        get_task("flat", "ppo:-1")


def test_every_number_states_its_range():
    """Beside its help text, so that none is forgotten."""
    for method in METHODS.values():
        task = method.task(name="flat")
        for owner in (task, *(each for each in vars(task).values() if dataclasses.is_dataclass(each))):
            hints = typing.get_type_hints(type(owner), include_extras=True)
            for name, hint in hints.items():
                bare = typing.get_args(hint)[0] if typing.get_origin(hint) is typing.Annotated else hint
                if bare in (int, float, tuple[int, ...]):
                    assert any(isinstance(each, Range) for each in getattr(hint, "__metadata__", ())), (owner, name)


@pytest.mark.parametrize(
    ("method", "path", "value", "why"),
    [
        ("ai-cpg", "ground.seed", 4, "ground.height_range is 0"),
        ("ai-cpg", "frequencies.jumps", 0.5, "frequencies.change_interval is 0"),
        ("ai-cpg", "pushes.interval", 2.0, "pushes.force is 0"),
        ("ai-cpg", "learning.symmetry", False, "equivariant"),
        ("ppo", "frequencies.minimum", 0.7, "target_speed sets the gait"),
        ("ppo", "resets.maximum_speed", 0.7, "start standing"),
        ("amp", "frequencies.maximum", 1.6, "reference sets the gait"),
        ("amp", "rewards.upright.weight", 2.0, "imitation.task_reward_weight is 0"),
    ],
)
def test_settings_that_do_nothing_are_refused(method: str, path: str, value: object, why: str):
    """Changed from what they were; as they are they do not matter, and where they do something they may be changed."""
    task, default = get_task("flat", method), get_task("flat", method)
    task.refuse_idle_changes(default)
    *parents, last = path.split(".")
    owner: object = task
    for parent in parents:
        owner = owner[parent] if isinstance(owner, dict) else getattr(owner, parent)
    setattr(owner, last, value)
    with pytest.raises(UserError, match=f"was changed, but does nothing: .*{why}"):
        task.refuse_idle_changes(default)
    task.ground.height_range = 0.1
    if method == "ai-cpg":
        task.frequencies.change_interval = 4.0
    task.pushes.force = 100.0
    task.learning.network = "mlp"
    if method == "amp":
        task.imitation.task_reward_weight = 1.0  # type: ignore[attr-defined]
    if parents[0] not in ("frequencies", "resets") or method == "ai-cpg":
        task.refuse_idle_changes(default)


def test_a_fixed_learning_rate_is_adapted_to_nothing():
    """A divergence to adapt it to does nothing then."""
    task, default = get_task("flat"), get_task("flat")
    for each in (task, default):
        each.learning.learning_rate_schedule = "fixed"
    task.learning.desired_kl = 0.1
    with pytest.raises(UserError, match=r"learning.desired_kl was changed, but does nothing: .*is fixed"):
        task.refuse_idle_changes(default)


def test_changes_that_cannot_be_are_refused():
    """A ramp that crosses the range in a step, strips without one to be level, pushes without an end."""
    task = get_task("robust")
    task.frequencies.change_rate = 60.0
    with pytest.raises(UserError, match=r"change_rate is 60.0 Hz/s; .* in one step \(48\)"):
        task.validate()
    task = get_task("robust")
    task.ground.levels = 1
    with pytest.raises(UserError, match=r"ground.level_strip takes one of ground.levels, which is 1"):
        task.validate()
    task = get_task("robust")
    task.pushes.duration = 3.0
    with pytest.raises(UserError, match=r"a push has to end before the next one"):
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
    found = [each for each in vars(task).values() if isinstance(each, type) and each.__module__ == task.__name__]
    assert {task.Learning, task.SpeedTask} < set(found)
    for each in found:
        body = source.split(f"class {each.__name__}", 1)[1]
        hints = typing.get_type_hints(each)
        for name in each.__annotations__:
            if dataclasses.is_dataclass(hints[name]):
                continue  # a group of settings: its class says what it is
            after = body.split(f"    {name}: ", 1)[1].split("\n", 2)[1]
            assert after.strip().startswith('"""'), name


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (64, (3e-5, 256, 10_000)),
        (256, (3e-5, 256, 10_000)),
        (1024, (5e-5, 1024, 40_000)),
        (4096, (5e-5, 4096, 160_000)),
        (32768, (5e-5, 4096, 160_000)),
    ],
)
def test_the_discriminators_settings_follow_the_number_of_environments(number: int, expected: tuple):
    """In proportion between what was tried and what was published; what is given is kept, the published 256 too."""
    task = get_task("flat", "amp")
    assert isinstance(task, ImitationTask)
    task.validate()
    names = ("discriminator_learning_rate", "discriminator_batch", "replay_size")
    chosen = task.for_environments(number)
    assert tuple(getattr(chosen.imitation, name) for name in names) == pytest.approx(expected)
    task.imitation.discriminator_batch, task.imitation.replay_size = 256, 10_000
    kept = task.for_environments(number).imitation
    assert (kept.discriminator_batch, kept.replay_size) == (256, 10_000)
    assert task.for_environments(number).for_environments(256) == task.for_environments(number)
    assert get_task("flat").for_environments(number) == get_task("flat")
