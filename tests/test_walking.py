"""The whole feedforward chain with physics: S, PD law, engine and environment together."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aicpg_newton.engines import Engine, Physics, make_engine
from aicpg_newton.engines.newton import NewtonEngine
from aicpg_newton.env.actuation import PatternActuation
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.robot import humanoid

CPU = torch.device("cpu")


def drive(engine: Engine, pattern: PatternNetwork, frequency: float) -> Environment:
    """An environment with all humanoids at one frequency."""
    environment = Environment(get_task("flat"), engine, pattern, seed=1)
    environment.restart(torch.full((engine.num_envs,), frequency))
    return environment


@pytest.mark.parametrize(("frequency", "least"), [(0.9, 0.7), (1.3, 0.5)])
def test_the_cpg_alone_takes_steps_forward_before_it_falls(pattern: PatternNetwork, frequency: float, least: float):
    """Without a reflex 64 humanoids stay up for a while in the mean, move forward and change feet."""
    environment = drive(make_engine("mujoco", 64, CPU, humanoid.motors(), Physics()), pattern, frequency)
    time_to_fall, distance = torch.full((64,), 3.0), torch.zeros(64)
    alive, single_support = torch.ones(64, dtype=torch.bool), torch.zeros(64, 2)
    for step in range(180):
        environment.step(torch.zeros(64, 28))
        state = environment.outcome.state
        loaded = state.foot_force[..., 2] > 50.0
        single_support += (loaded & ~loaded.flip(1)) * alive.unsqueeze(1)
        ended = alive & (environment.outcome.fallen | environment.outcome.off_course)
        time_to_fall[ended] = (step + 1) / 60
        distance = torch.where(alive, state.root_position[:, 0], distance)
        alive &= ~ended
    print(f"{frequency} Hz: mean time to fall {time_to_fall.mean():.2f} s, way {distance.mean():.2f} m")
    assert time_to_fall.mean() >= least
    assert distance.mean() > 0.3 * time_to_fall.mean()
    # Each foot alone carries the body for a fair share of the time: steps, not a dive.
    assert (single_support.mean(dim=0) > 6).all()


def test_joints_follow_the_pattern_with_the_pelvis_held_in_the_air(pattern: PatternNetwork):
    """Gains, damping, joint order and signs are right if the limbs follow S with an RMS error under 0.15 rad."""
    engine = make_engine("mujoco", 8, CPU, humanoid.motors(), Physics())
    environment = drive(engine, pattern, 0.9)
    environment.restart(torch.linspace(0.8, 1.4, 8))
    height, upright = torch.tensor([0.0, 0.0, 3.0]).repeat(8, 1), torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(8, 1)
    everyone, still = torch.ones(8, dtype=torch.bool), torch.zeros(8, 3)
    errors = []
    for step in range(120):
        environment.step(torch.zeros(8, 28))
        state = environment.outcome.state
        if step >= 30:
            assert isinstance(environment.actuation, PatternActuation)
            errors.append(environment.actuation.target - state.joint_position)
        held = replace(
            state,
            root_position=height,
            root_rotation=upright,
            root_linear_velocity=still,
            root_angular_velocity=still,
        )
        engine.reset(everyone, held)
    error = torch.stack(errors)
    print(f"RMS error {error.square().mean().sqrt():.3f} rad")
    assert error.square().mean().sqrt() < 0.15


def test_observations_and_rewards_do_not_depend_on_the_engines_layout(pattern: PatternNetwork, permuted_mjcf: Path):
    """With the links of the file in another order, all 192 observations and all reward terms are the same."""
    environments = [
        Environment(
            get_task("flat"),
            NewtonEngine(4, CPU, humanoid.motors(), Physics(), mjcf=mjcf),
            pattern,
            seed=2,
        )
        for mjcf in (humanoid.MJCF_PATH, permuted_mjcf)
    ]
    actions = torch.randn(10, 4, 28, generator=torch.Generator().manual_seed(0))
    for action in actions:
        seen, rewards = zip(*[each.step(action)[:2] for each in environments], strict=True)
    observed = [each["policy"] for each in seen]
    assert not torch.allclose(observed[0], observed[0].roll(1, dims=0), atol=0.1)
    torch.testing.assert_close(observed[0], observed[1], rtol=0.0, atol=2e-2)
    torch.testing.assert_close(rewards[0], rewards[1], rtol=0.0, atol=1e-3)
    for name, term in environments[0].outcome.reward_terms.items():
        torch.testing.assert_close(environments[1].outcome.reward_terms[name], term, rtol=0.0, atol=1e-3)
