"""Simulations that go wrong are told by their cause, counted, and leave all others as they were, bit for bit."""

from __future__ import annotations

import pytest
import torch

from aicpg_newton.engines import Engine
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.faults import CAUSES, BadStates, FaultCount, cause_of, sentence
from aicpg_newton.env.registry import get_task
from aicpg_newton.gait.cpg import PatternNetwork

NAN, INF = float("nan"), float("inf")


def test_causes_in_order(random_state):
    """Each by itself, and the first of several."""
    state, height = random_state(9), torch.full((9,), 0.9)
    state.joint_velocity *= 10.0
    overflowed = torch.zeros(9, dtype=torch.bool)
    overflowed[[1, 7]] = True
    state.foot_moment[2, 1, 0] = state.root_linear_velocity[7, 0] = state.root_linear_velocity[8, 0] = NAN
    state.root_linear_velocity[3, 1] = -51.0
    state.root_angular_velocity[4, 2] = 101.0
    state.joint_velocity[5, 27] = state.joint_velocity[8, 3] = -501.0
    height[6] = 11.0
    found = cause_of(state, height, overflowed).tolist()
    names = [("", *CAUSES)[cause] for cause in found]
    assert names == ["", "overflow", "not_finite", *["too_fast"] * 3, "too_high", "not_finite", "not_finite"]


def test_counts_and_their_sentence():
    """By cause, since the last time; nothing to say about nothing."""
    count = FaultCount(3, torch.device("cpu"))
    assert sentence(count.take()) == ""
    for cause in ([0, 4, 2], [1, 1, 0]):
        count.note(torch.tensor(cause))
    counts = count.take()
    assert counts == {"not_finite": 2, "too_fast": 1, "too_high": 0, "overflow": 1}
    said = sentence(counts)
    assert "reset: 4 (2 not finite, 1 faster than any body, 1 out of contact buffers)" in said
    assert "max-contacts" in said and said.count(".") == 3  # names of settings have one each
    assert sum(count.take().values()) == 0


def test_the_first_bad_step_is_kept():
    """Of each robot, until it is asked for."""
    kept = BadStates(3, torch.device("cpu"))
    kept.note(torch.tensor([0, 2, 0]), {"speed": torch.tensor([[1.0], [2.0], [3.0]])})
    kept.note(torch.tensor([0, 3, 1]), {"speed": torch.tensor([[4.0], [5.0], [6.0]])})
    taken = kept.take()
    assert {name: each.tolist() for name, each in taken.items()} == {
        "robot": [1, 2],
        "cause": [2, 1],
        "speed": [[2.0], [6.0]],
    }
    kept.note(torch.tensor([0, 3, 0]), {"speed": torch.tensor([[7.0], [8.0], [9.0]])})
    assert kept.take()["speed"].tolist() == [[8.0]]


def test_an_overflow_resets_that_robot_alone(puppet, pattern: PatternNetwork):
    """It earns nothing, and is counted."""
    environment = Environment(get_task("flat"), puppet(4), pattern)
    environment.engine.overflowed[2] = True
    _, reward, dones, _ = environment.step(torch.zeros(4, 28))
    assert dones.tolist() == [0, 0, 1, 0] and reward[2] == 0.0 and (reward[[0, 1, 3]] > 0).all()
    assert environment.faults.take()["overflow"] == 1


def motion_of(task_name: str, engine: Engine, pattern: PatternNetwork, steps: int, *faulty: int) -> Environment:
    """Walk under pushes and changing frequencies, and have everything done to the faulty robots, in turn.

    The result is the environment, with what all robots saw, earned and ended as ``trajectory``.
    """
    task = get_task(task_name)
    task.pushes.force, task.frequencies.change_interval = 200.0, 1.0
    bad = torch.zeros(engine.num_envs, 1, dtype=torch.bool)
    bad[list(faulty)] = True
    place = "rows" if engine.name == "mujoco" else "joint_q"
    height = 3 if engine.name == "mujoco" else 2

    def shifted(columns: slice, by: float) -> None:
        snapshot = engine.snapshot()
        snapshot[place][:, columns] = torch.where(bad, snapshot[place][:, columns] + by, snapshot[place][:, columns])
        engine.restore(snapshot)

    take_step, done = type(engine).step.__get__(engine), 0

    def step(target, target_velocity, torque, *, push) -> None:
        nonlocal done
        kind, done = done % 12, done + 1
        if kind == 0:
            shifted(slice(height, height + 12), NAN)
        elif kind == 2:
            torque = torch.where(bad, INF, torque)
        elif kind == 4:
            shifted(slice(height, height + 1), 1e5)
        elif kind == 6:
            shifted(slice(height, height + 1), -1.5)
        elif kind == 8:
            shifted(slice(height - 2, height), 1e4)
        elif kind == 10:
            push = torch.where(bad, 1e7, push)
        take_step(target, target_velocity, torque, push=push)

    engine.step = step  # type: ignore[method-assign]
    try:
        environment = Environment(task, engine, pattern, seed=5)
        generator = torch.Generator().manual_seed(6)
        seen = []
        for _ in range(steps):
            actions = 0.3 * torch.randn(engine.num_envs, 28, generator=generator)
            observed, reward, dones, _ = environment.step(actions)
            assert torch.isfinite(observed["policy"]).all() and torch.isfinite(reward).all()
            assert (reward[environment.outcome.diverged] == 0).all()
            seen.append(torch.cat((observed["policy"], reward.unsqueeze(1), dones.unsqueeze(1)), dim=1))
    finally:
        del engine.step
    environment.trajectory = torch.stack(seen)  # type: ignore[attr-defined]
    return environment


def others_are_undisturbed(task: str, name: str, pattern: PatternNetwork, num_envs: int, steps: int) -> None:
    """Two runs of one engine, with faults in robot 1 and without."""
    engine = engine_for(get_task(task), name, num_envs, "cpu")
    sound, faulty = (motion_of(task, engine, pattern, steps, *bad) for bad in ((), (1,)))
    others = torch.arange(num_envs) != 1
    before, after = (each.trajectory for each in (sound, faulty))  # type: ignore[attr-defined]
    assert torch.equal(before[:, others], after[:, others])
    assert not torch.equal(before[:, 1], after[:, 1])
    assert sum(sound.faults.take().values()) == 0
    counts = faulty.faults.take()
    assert counts["not_finite"] >= steps // 12 and sum(counts.values()) >= 3 * (steps // 12)


@pytest.mark.parametrize("task", ["flat", "uneven"])
@pytest.mark.parametrize(("name", "num_envs", "steps"), [("mujoco", 12, 48), ("newton", 4, 36)])
def test_faults_leave_the_others_as_they_were(name: str, num_envs: int, steps: int, task: str, pattern: PatternNetwork):
    """NaN, infinite torques, teleports up, down and far away, 1e7 N: the other robots' motion has the same bits."""
    others_are_undisturbed(task, name, pattern, num_envs, steps)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mujoco", "newton"])
def test_faults_in_one_of_a_hundred(name: str, pattern: PatternNetwork):
    """The same for 200 steps."""
    others_are_undisturbed("flat", name, pattern, 100, 200)
