"""The control step: torques, phase, falls, rewards, resets, pushes."""

import math

import pytest
import torch

from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.env import environment as module
from aicpg_newton.env.actuation import PatternActuation
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Frequencies, Pushes
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork, advance_phase
from aicpg_newton.gait.poses import gait_pose
from aicpg_newton.learning.runner import Runner
from aicpg_newton.robot import humanoid, rotations
from aicpg_newton.robot.kinematics import sole_corners, sole_heights

EVERYTHING = ("root_position", "root_rotation", "root_linear_velocity", "root_angular_velocity", "joint_velocity")


@pytest.fixture
def environment(puppet, pattern: PatternNetwork) -> Environment:
    """Six environments on an engine that obeys."""
    return Environment(get_task("flat"), puppet(6), pattern, seed=3)


def rest(environment: Environment) -> torch.Tensor:
    """Actions that do nothing."""
    return torch.zeros(environment.num_envs, 28)


def test_frequencies_are_spread_over_the_range(environment: Environment):
    """Evenly, inside 0.8 to 1.4 Hz."""
    assert environment.commands.frequency.tolist() == pytest.approx([0.85, 0.95, 1.05, 1.15, 1.25, 1.35])


def test_observations_have_the_papers_size(environment: Environment):
    """192 per environment, under the key rsl_rl is told."""
    assert environment.get_observations()["policy"].shape == (6, 192)


def test_reflex_torque_is_a_share_of_the_gear(environment: Environment):
    """An action of 1 is 0.4 of each joint's gear, and no action exceeds the gear."""
    environment.step(torch.ones(6, 28))
    gear = humanoid.motors().gear
    sent = environment.engine.calls[-1]["torque"]  # type: ignore[attr-defined]
    assert torch.allclose(sent, 0.4 * gear.expand(6, 28))
    environment.step(torch.full((6, 28), -100.0))
    assert torch.allclose(environment.engine.calls[-1]["torque"], -gear.expand(6, 28))  # type: ignore[attr-defined]


def test_targets_follow_the_rhythm_generator(environment: Environment):
    """The engine gets S at the step's phase; afterwards the phase has moved by the environment's own frequency."""
    phase = environment.phase.clone()
    expected, _ = environment.pattern.target(phase, environment.commands.frequency)
    environment.step(rest(environment))
    assert torch.allclose(environment.engine.calls[-1]["target"], expected)  # type: ignore[attr-defined]
    assert torch.allclose(environment.outcome.phase, advance_phase(phase, environment.commands.frequency))


def test_a_command_is_obeyed_at_one_instant(environment: Environment):
    """Phase, target, observation and record change together, when the coming step is over."""
    environment.restart(torch.full((6,), 0.7))
    phase, (planned, _) = (
        environment.phase.clone(),
        environment.pattern.target(environment.phase, torch.full((6,), 0.7)),
    )
    environment.command(frequency=torch.full((6,), 1.4))
    environment.step(rest(environment))
    assert torch.allclose(environment.engine.calls[-1]["target"], planned)  # type: ignore[attr-defined]
    assert torch.allclose(environment.phase, advance_phase(phase, torch.full((6,), 0.7)))
    assert environment.outcome.commands.frequency.tolist() == pytest.approx([0.7] * 6)
    assert environment.commands.frequency.tolist() == pytest.approx([1.4] * 6)
    phase = environment.phase.clone()
    target, _ = environment.pattern.target(phase, torch.full((6,), 1.4))
    assert torch.allclose(environment.get_observations()["policy"][:, 136:164], target, atol=1e-6)
    environment.step(rest(environment))
    assert torch.allclose(environment.engine.calls[-1]["target"], target)  # type: ignore[attr-defined]
    assert torch.allclose(environment.outcome.phase, advance_phase(phase, torch.full((6,), 1.4)))
    assert environment.outcome.commands.frequency.tolist() == pytest.approx([1.4] * 6)


def test_commands_add_up_and_a_restart_drops_them(environment: Environment):
    """What is not told stays as it was, and a later word counts."""
    before = environment.commands.frequency.clone()
    environment.command(frequency=torch.full((6,), 1.0))
    environment.command(heading=torch.full((6,), 0.5))
    environment.command(frequency=torch.full((6,), 1.2))
    environment.step(rest(environment))
    assert environment.commands.frequency.tolist() == pytest.approx([1.2] * 6)
    assert environment.commands.heading.tolist() == pytest.approx([0.5] * 6)
    environment.command(frequency=torch.full((6,), 1.3))
    environment.restart(before)
    environment.step(rest(environment))
    assert torch.equal(environment.commands.frequency, before)


def test_reward_is_the_weighted_sum_of_the_terms(environment: Environment):
    """Eq. 5 with the paper's weights, times the scale, worked out from the state."""
    engine = environment.engine
    engine.overrides = {"root_linear_velocity": torch.tensor([2.0, 0.5, 0.0]).repeat(6, 1)}  # type: ignore[attr-defined]
    _, reward, _, _ = environment.step(torch.full((6, 28), 0.2))
    state = environment.outcome.state
    terms = environment.task.rewards
    hat = torch.full((28,), 0.08)
    energy = (terms["action_energy"].parameters["velocity_scale"] * hat * state.joint_velocity).abs().sum(1)
    energy += (hat**2).sum()
    assert isinstance(environment.actuation, PatternActuation)
    error = (environment.actuation.target - state.joint_position).abs().sum(1)
    upright = rotations.up_axis(state.root_rotation)[:, 2]
    tracking = (1 - error / terms["pattern_tracking"].parameters["bound"]).clamp_min(0)
    expected = 1.5 - 0.5 * energy + 1.0 + upright + 2.0 + 5.0 * tracking
    assert torch.allclose(reward, 0.01 * expected, atol=1e-6)
    assert set(environment.outcome.reward_terms) == set(environment.task.rewards)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("root_position", [0.0, 0.0, 0.54]),
        ("root_rotation", [math.sin(math.radians(31)), 0.0, 0.0, math.cos(math.radians(31))]),
        ("root_rotation", [0.0, math.sin(math.radians(31)), 0.0, math.cos(math.radians(31))]),
        ("joint_velocity", [float("nan")] * 28),
        ("joint_velocity", [0.0] * 27 + [1e4]),
        ("root_linear_velocity", [1e4, 0.0, 0.0]),
        ("root_angular_velocity", [0.0, 300.0, 0.0]),
    ],
)
def test_a_fall_earns_nothing_and_resets_that_environment_alone(
    environment: Environment, name: str, value: list[float]
):
    """Below 0.55 m, tilted by 62 degrees either way, not finite, or faster than any body: 1e4 m/s earned 1001 once."""
    environment.step(rest(environment))
    before = getattr(environment.engine.state, name).clone()
    before[2] = torch.tensor(value)
    environment.engine.overrides = {name: before}  # type: ignore[attr-defined]
    observed, reward, dones, extras = environment.step(rest(environment))
    assert environment.outcome.fallen.tolist() == [False, False, True, False, False, False]
    assert dones.tolist() == [0, 0, 1, 0, 0, 0]
    assert environment.outcome.diverged.any() == name.endswith("velocity")
    assert reward[2] == 0.0
    assert (reward[[0, 1, 3, 4, 5]] > 0).all()
    assert environment.engine.last_reset["mask"].tolist() == environment.outcome.fallen.tolist()  # type: ignore[attr-defined]
    assert torch.isfinite(observed["policy"]).all()
    assert torch.isfinite(reward).all()
    assert not extras["time_outs"].any()
    assert environment.episode_length_buf.tolist() == [2, 2, 0, 2, 2, 2]


def test_no_fall_just_inside_the_limits(environment: Environment):
    """0.56 m and 58 degrees are not yet a fall."""
    tilt = math.radians(29)
    environment.engine.overrides = {  # type: ignore[attr-defined]
        "root_position": torch.tensor([0.0, 0.0, 0.56]).repeat(6, 1),
        "root_rotation": torch.tensor([math.sin(tilt), 0.0, 0.0, math.cos(tilt)]).repeat(6, 1),
    }
    environment.step(rest(environment))
    assert not environment.outcome.fallen.any()


def test_turning_away_ends_the_episode(environment: Environment):
    """60 degrees of yaw is off course, not a fall; 50 is neither. That is so in tests; training has no such limit."""
    yaw = torch.deg2rad(torch.tensor([0.0, 50.0, -50.0, 60.0, -60.0, 180.0]))
    environment.engine.overrides = {"root_rotation": rotations.about_z(yaw)}  # type: ignore[attr-defined]
    environment.step(rest(environment))
    assert not environment.outcome.off_course.any()
    environment.task.termination = environment.task.undisturbed().termination
    _, reward, dones, _ = environment.step(rest(environment))
    assert environment.outcome.off_course.tolist() == [False, False, False, True, True, True]
    assert dones.tolist() == [0, 0, 0, 1, 1, 1]
    assert not environment.outcome.fallen.any()
    assert (reward[3:] == 0).all()


def test_time_out_is_no_failure(environment: Environment):
    """The last step of an episode pays its reward and is reported as a time-out."""
    environment.episode_length_buf[4] = environment.max_episode_length - 1
    _, reward, dones, extras = environment.step(rest(environment))
    assert extras["time_outs"].tolist() == dones.bool().tolist() == [False] * 4 + [True, False]
    assert reward[4] > 0


def test_episode_rewards_are_means_per_step(environment: Environment):
    """Three steps and a fall: the log holds the mean of the weighted term over the episode, until another one ends."""
    for _ in range(3):
        environment.step(rest(environment))
    low = environment.engine.state.root_position.clone()
    low[1, 2] = 0.1
    environment.engine.overrides = {"root_position": low}  # type: ignore[attr-defined]
    log = environment.step(rest(environment))[3]["log"]
    assert log["Episode_Reward/survival"].item() == pytest.approx(0.01 * 3 / 4)
    assert log["Episode_End/fallen"].item() == 1.0
    environment.engine.overrides = {}  # type: ignore[attr-defined]
    assert environment.step(rest(environment))[3]["log"]["Episode_Reward/survival"] == log["Episode_Reward/survival"]
    environment.episode_length_buf[1] = environment.max_episode_length
    log = environment.step(rest(environment))[3]["log"]
    assert log["Episode_Reward/survival"].item() == pytest.approx(0.01)
    assert log["Episode_End/fallen"].item() == 0.0


def test_actions_that_are_not_finite_are_refused(environment: Environment):
    """A diverged policy is an error, not a thousand quiet resets."""
    with pytest.raises(UserError, match="not finite"):
        environment.step(torch.full((6, 28), float("nan")))


def test_on_a_gpu_actions_are_looked_at_before_the_update(puppet, pattern: PatternNetwork, monkeypatch):
    """Not in every step, which would wait for it; nothing is learned from them, and nothing is lost."""
    monkeypatch.setattr(module, "reading_is_free", lambda device: False)
    task = get_task("flat")
    task.learning.hidden_sizes = (16,)
    runner = Runner(Environment(task, puppet(4), pattern), {"seed": 0})
    before = {name: value.clone() for name, value in runner.alg.actor.state_dict().items()}
    runner.env.step(torch.full((4, 28), float("nan")))
    with pytest.raises(UserError, match="not finite"):
        runner.alg.update()
    after = runner.alg.actor.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before if name.startswith("mlp"))


def test_start_states_are_those_of_the_gait(environment: Environment):
    """Pose, joint velocities and half to full speed of the CPG at a random phase; soles on the ground."""
    start = environment.engine.last_reset  # type: ignore[attr-defined]
    speed = environment.pattern.nominal_speed(environment.commands.frequency)
    share = start["root_linear_velocity"][:, 0] / speed
    assert ((share > 0.35) & (share < 1.25)).all()
    assert environment.phase.unique().numel() == 6
    target, rate = environment.pattern.target(environment.phase, environment.commands.frequency)
    assert torch.allclose(start["joint_position"], target)
    assert torch.allclose(start["joint_velocity"], rate)
    soles = sole_heights(start["root_position"], start["root_rotation"], start["joint_position"]).amin(dim=1)
    assert ((soles > -1e-5) & (soles < 0.08)).all()


def test_start_velocities_are_the_rates_of_the_gait_pose(environment: Environment):
    """Moving the start pose on by its velocities for one step gives the gait's next pose."""
    start = environment.engine.last_reset  # type: ignore[attr-defined]
    following = gait_pose(
        environment.pattern,
        advance_phase(environment.phase, environment.commands.frequency),
        environment.commands.frequency,
    )
    angular = start["root_angular_velocity"] / 60
    angle = angular.norm(dim=1)
    turned = rotations.multiply(rotations.about_axis(angular / angle.unsqueeze(1), angle), start["root_rotation"])
    # The rate is taken as twice the sine of half the angle, which is the angle to third order.
    assert torch.allclose(turned, following.root_rotation, atol=1e-4)
    moved = start["root_position"][:, 1:] + start["root_linear_velocity"][:, 1:] / 60
    assert torch.allclose(moved, following.root_position[:, 1:], atol=1e-5)


def test_the_same_seed_starts_the_same_way(puppet, pattern: PatternNetwork):
    """Phases and speeds are drawn from the seed alone."""
    first, second, third = (Environment(get_task("flat"), puppet(4), pattern, seed=seed) for seed in (7, 7, 8))
    for name in EVERYTHING[:-1]:
        assert torch.equal(first.engine.last_reset[name], second.engine.last_reset[name])  # type: ignore[attr-defined]
    assert not torch.equal(first.phase, third.phase)


def hills() -> Terrain:
    """A small terrain of two levels."""
    terrain = Terrain.make(Ground(height_range=0.2, length=20.0, width=20.0, levels=2, seed=4))
    assert terrain is not None
    return terrain


@pytest.fixture
def on_hills(puppet, pattern: PatternNetwork) -> Environment:
    """Forty environments on uneven ground."""
    task = get_task("uneven")
    terrain = hills()
    task.ground = terrain.ground
    return Environment(task, puppet(40, terrain), pattern, seed=3)


def test_start_states_stand_on_the_terrain(on_hills: Environment):
    """No sole corner is below the surface, and each pelvis is as high above it as the gait's, or higher."""
    start = on_hills.engine.last_reset  # type: ignore[attr-defined]
    corners = sole_corners(start["root_position"], start["root_rotation"], start["joint_position"]).flatten(1, 2)
    clearance = (corners[..., 2] - hills().height(corners)).amin(dim=1)
    assert clearance.min() > -1e-5
    gait = gait_pose(on_hills.pattern, on_hills.phase, on_hills.commands.frequency).root_position[:, 2]
    raised = start["root_position"][:, 2] - hills().height(start["root_position"]) - gait
    assert raised.min() > -1e-5
    assert raised.max() < 0.1
    assert (clearance[raised > 1e-4] < 1e-5).all()  # raised no more than needed
    assert start["root_position"][:, :2].std(dim=0).min() > 0.5  # spread over the first level's start area
    assert start["root_position"][:, 1].max() < 0.0


def test_heights_count_from_the_ground_below(on_hills: Environment):
    """Lifted with the ground, a robot neither falls nor earns more; sinking towards it, it falls."""
    engine = on_hills.engine
    place = torch.tensor([[5.0, y, 0.0] for y in torch.linspace(-8.5, 8.5, 40).tolist()])
    ground = hills().height(place)
    assert ground.std() > 0.01
    upright = torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(40, 4)

    def stand(height: float) -> None:
        above = torch.stack((place[:, 0], place[:, 1], ground + height), dim=1)
        head = torch.stack((place[:, 0], place[:, 1], ground + height + 0.6), dim=1)
        engine.overrides = {"root_position": above, "root_rotation": upright, "head_position": head}  # type: ignore[attr-defined]
        on_hills.step(rest(on_hills))

    stand(0.9)
    outcome = on_hills.outcome
    assert not outcome.fallen.any()
    assert torch.allclose(outcome.reward_terms["head_height"], torch.full((40,), 0.015), atol=1e-6)
    assert torch.allclose(on_hills.get_observations()["policy"][:, 0], torch.full((40,), 0.9), atol=1e-5)
    assert torch.allclose(outcome.ground_height, ground)
    stand(0.54)
    assert on_hills.outcome.fallen.all()


def test_the_edge_of_the_terrain_ends_an_episode_without_a_fall(on_hills: Environment):
    """As a time-out, so that its value is bootstrapped."""
    position = on_hills.engine.state.root_position.clone()
    position[0, 0], position[1, 1], position[2, 0] = 19.5, 9.5, 0.5
    position[:, 2] = 1.0
    on_hills.engine.overrides = {"root_position": position}  # type: ignore[attr-defined]
    _, _, dones, extras = on_hills.step(rest(on_hills))
    assert extras["time_outs"].nonzero().flatten().tolist() == [0, 1, 2]
    assert dones.nonzero().flatten().tolist() == [0, 1, 2]
    assert not on_hills.outcome.fallen.any()


def test_the_curriculum_moves_robots_that_last_to_rougher_ground(on_hills: Environment):
    """Up after half an episode or more, down after a fall, within the levels; starts are on the level's strip."""
    on_hills.episode_length_buf[:3] = on_hills.max_episode_length
    on_hills._episode_steps[:2] = 0.5 * on_hills.max_episode_length  # the third's time is out at once
    position = on_hills.engine.state.root_position.clone()
    position[:, 2] = 1.0
    position[1, 2] = 0.0
    on_hills.engine.overrides = {"root_position": position}  # type: ignore[attr-defined]
    on_hills.step(rest(on_hills))
    assert on_hills.level.tolist() == [1] + [0] * 39
    assert on_hills.engine.last_reset["root_position"][0, 1] > 0.0  # type: ignore[attr-defined]
    on_hills.level[1] = 1
    on_hills.episode_length_buf[0] = on_hills.max_episode_length
    on_hills._episode_steps[0] = 0.5 * on_hills.max_episode_length
    on_hills.step(rest(on_hills))
    assert on_hills.level[1] == 0
    on_hills.level[:] = 1
    on_hills._episode_steps[:] = 0.5 * on_hills.max_episode_length
    on_hills.episode_length_buf[:] = on_hills.max_episode_length
    position[:, 2] = 1.0
    on_hills.step(rest(on_hills))
    assert 5 < on_hills.level.sum() < 35  # those that lasted on the roughest begin anywhere


def test_frequencies_change_at_random_times(puppet, pattern: PatternNetwork):
    """By no more than the rate, with some jumps, over the whole range; a new episode begins at the robot's own."""
    task = get_task("flat")
    task.frequencies = Frequencies(minimum=0.6, maximum=1.4, change_interval=1.0, change_rate=0.3, jumps=0.25)
    environment = Environment(task, puppet(200), pattern, seed=1)
    own = environment.commands.frequency.clone()
    told = [own]
    for step in range(300):
        if step == 200:
            environment.episode_length_buf[:100] = environment.max_episode_length
        environment.step(torch.zeros(200, 28))
        assert torch.equal(environment.outcome.commands.frequency, told[-1])
        told.append(environment.commands.frequency)
    assert torch.equal(told[201][:100], own[:100])
    change = torch.diff(torch.stack(told[:201]), dim=0)
    slow = change.abs() <= 0.3 / 60 + 1e-6
    assert 0.15 * 200 * 200 / 60 < (~slow).sum() < 0.35 * 200 * 200 / 60  # a quarter of a change a second
    assert change.amin() < -0.3 and change.amax() > 0.3 and (change[slow] > 0.8 * 0.3 / 60).any()
    last = torch.stack(told)[200]
    assert 0.6 <= last.amin() < 0.65 and 1.35 < last.amax() <= 1.4 + 1e-6
    assert abs(float(torch.corrcoef(torch.stack((own, last)))[0, 1])) < 0.4


def test_a_restart_forgets_where_frequencies_were_going(puppet, pattern: PatternNetwork):
    """Robots keep the frequencies of the restart until their next change."""
    task = get_task("flat")
    task.frequencies = Frequencies(minimum=0.6, maximum=1.4, change_interval=1e-3, change_rate=0.3)
    environment = Environment(task, puppet(4), pattern)
    environment.step(torch.zeros(4, 28))
    changes = environment._changes
    assert changes is not None
    changes._due = 0.0  # all are on their way by now, and nothing new is drawn
    environment.restart(torch.full((4,), 1.0))
    for _ in range(5):
        environment.step(torch.zeros(4, 28))
    assert environment.commands.frequency.tolist() == pytest.approx([1.0] * 4)


def test_undisturbed_frequencies_stay(puppet, pattern: PatternNetwork):
    """For tests and play: nobody pushes and f is what it is told."""
    task = get_task("robust").undisturbed()
    assert get_task("robust").physics.substeps == 2 and task.physics.substeps == 4
    task.ground = Ground()
    task.validate()
    environment = Environment(task, puppet(4), pattern)
    before = environment.commands.frequency.clone()
    for _ in range(50):
        environment.step(torch.zeros(4, 28))
    assert torch.equal(environment.commands.frequency, before)
    assert environment.engine.calls[-1]["push"] is None  # type: ignore[attr-defined]


def test_pushes(puppet, pattern: PatternNetwork):
    """A push lasts 0.1 s of every second, is constant while it lasts and stays within the force."""
    task = get_task("flat")
    task.pushes.force = 200.0
    environment = Environment(task, puppet(5), pattern)
    for _ in range(180):
        environment.step(rest(environment))
    pushes = torch.stack([call["push"] for call in environment.engine.calls])  # type: ignore[attr-defined]
    active = pushes.abs().sum(dim=2) > 0
    assert (pushes.abs() <= 200.0).all()
    assert pushes.abs().max() > 100.0
    for env in range(5):
        edges = torch.diff(active[:, env].int(), prepend=torch.zeros(1, dtype=torch.int))
        begins, ends = (edges == 1).nonzero().flatten(), (edges == -1).nonzero().flatten()
        assert len(begins) in (2, 3)
        assert (ends - begins[: len(ends)]).tolist() == [6] * len(ends)
        assert torch.diff(begins).tolist() == [60] * (len(begins) - 1)
        for begin in begins:
            assert len(pushes[begin : begin + 6, env].unique(dim=0)) == 1


def test_pushes_grow_with_the_level(puppet, pattern: PatternNetwork):
    """None on the first level, half of the force in the middle, all of it on the last."""
    task = get_task("uneven")
    task.ground.levels, task.ground.level_strip = 3, True
    task.pushes = Pushes(force=100.0, duration=1.0, interval=1.0, grow_with_level=True)
    task.validate()
    environment = Environment(task, puppet(300, Terrain.make(task.ground)), pattern)
    largest = torch.zeros(3)
    for _ in range(60):
        environment.level = torch.arange(300) % 3
        environment.step(torch.zeros(300, 28))
        push = environment.engine.calls[-1]["push"]  # type: ignore[attr-defined]
        assert push is not None
        seen = push.abs().amax(dim=1)
        largest = torch.maximum(largest, torch.stack([seen[level::3].max() for level in range(3)]))
    assert largest.tolist() == pytest.approx([0.0, 50.0, 100.0], abs=2.0) and largest[0] == 0.0
    task.ground.levels, task.ground.level_strip = 1, False
    with pytest.raises(UserError, match=r"pushes\.grow_with_level needs levels"):
        task.validate()


def test_no_pushes_by_default(environment: Environment):
    """The flat task leaves the robot alone."""
    environment.step(rest(environment))
    assert environment.engine.calls[-1]["push"] is None  # type: ignore[attr-defined]
