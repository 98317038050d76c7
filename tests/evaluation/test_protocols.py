"""Protocols run with a robot whose motion is known, and what is read off."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from aicpg_newton.engines import Physics, make_engine
from aicpg_newton.engines.terrain import Ground, Terrain
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.registry import get_task
from aicpg_newton.evaluation import summaries, transition_summaries
from aicpg_newton.evaluation.protocols import (
    DISTURBANCE,
    PROTOCOLS,
    SLOWING,
    SPEED,
    SWEEP,
    TERRAIN,
    TERRAIN_SEEDS,
    TRAINING,
    TRANSITION,
    UP_AND_DOWN,
    Protocol,
)
from aicpg_newton.evaluation.summaries import Source
from aicpg_newton.evaluation.trajectories import Trajectories, record
from aicpg_newton.playing.rollout import share_out
from aicpg_newton.robot.humanoid import motors
from aicpg_newton.robot.kinematics import sole_heights

SOURCE = Source("AI-CPG", 3, 100)


def run(protocol: Protocol, engine, pattern, frequencies=None) -> Trajectories:
    """A trajectories of the CPG alone, on the engine's ground."""
    task = get_task("flat").undisturbed()
    if engine.terrain is not None:
        task.ground = engine.terrain.ground
    task.pushes = protocol.pushes()
    task.termination.episode_steps = protocol.steps + 1
    environment = Environment(task, engine, pattern)
    start = torch.tensor(protocol.frequencies if frequencies is None else frequencies)
    return record(protocol, start, environment, lambda observed: observed.new_zeros(len(observed), 28))


def test_protocols_are_the_papers():
    """Frequencies, times and forces of Sec. III."""
    assert SWEEP.frequencies[0] == 0.7 and SWEEP.frequencies[-1] == 1.4 and SWEEP.duration == 20.0
    assert SWEEP.frequencies == tuple(sorted(SWEEP.frequencies)) and SWEEP.groups == 15
    pushes = DISTURBANCE.pushes()
    assert (pushes.force, pushes.duration, pushes.interval) == (200.0, 0.1, 1.0)
    assert DISTURBANCE.steps == 3600 and DISTURBANCE.checkpoints == 5
    assert TRANSITION.frequencies == (0.7,) and TRANSITION.ramp == 0.023 and TRANSITION.steps == 1800
    assert SWEEP.pushes().force == TRANSITION.pushes().force == SPEED.pushes().force == 0.0
    for protocol in PROTOCOLS.values():
        assert protocol.columns[-1] == "reason" and len(set(protocol.columns)) == len(protocol.columns)
    assert SWEEP.columns[:-1] == (
        *("method", "condition", "frequency_hz", "seed", "speed_mps", "cost_of_transport", "symmetry_index"),
        *("balance_index", "froude", "flight_ratio", "survived", "falls_per_minute"),
    )
    assert TERRAIN.frequencies == TRAINING.frequencies == (0.9, 1.3)
    assert TERRAIN.duration == 20.0 and TRAINING.duration == 10.0 and len(set(TERRAIN_SEEDS)) == 5


def test_checkpoints_of_a_training():
    """The last ones, or some from the first to the last, and never one twice."""
    files = list(range(61))
    assert SWEEP.pick(files) == [60] and DISTURBANCE.pick(files) == [56, 57, 58, 59, 60]
    assert DISTURBANCE.pick([7]) == TRAINING.pick([7]) == [7] and SWEEP.pick([]) == TRAINING.pick([]) == []
    even = TRAINING.pick(files)
    assert len(even) == 12 and (even[0], even[-1]) == (0, 60) and set(np.diff(even)) <= {5, 6}
    assert TRAINING.pick(files[:5]) == files[:5]


def test_environments_are_shared_out_evenly():
    """64 over 15 groups: 4 or 5 each, in order."""
    shares = share_out(64, 15)
    assert set(shares.bincount().tolist()) == {4, 5}
    assert shares.tolist() == sorted(shares.tolist())


def test_a_sweep_reads_off_the_known_motion(glider, pattern):
    """Two groups of two robots at 1, 1.5, 2 and 2.5 m/s; 100 W; flight in 12 of 60 steps."""
    protocol = replace(SWEEP, duration=6.0, frequencies=(0.8, 1.2))
    trajectories = run(protocol, glider(4), pattern)
    assert trajectories.frequency[-1].tolist() == pytest.approx([0.8, 0.8, 1.2, 1.2])
    rows, summary = summaries.sweep_rows(trajectories, torch.tensor(protocol.frequencies), SOURCE)
    assert [row["frequency_hz"] for row in rows] == pytest.approx([0.8, 1.2])
    assert [row["speed_mps"] for row in rows] == pytest.approx([1.25, 2.25], rel=1e-3)
    weight = 48.9 * 9.81
    cost = [0.5 * (100 / weight / 1.0 + 100 / weight / 1.5), 0.5 * (100 / weight / 2.0 + 100 / weight / 2.5)]
    assert [row["cost_of_transport"] for row in rows] == pytest.approx(cost, rel=1e-3)
    assert [row["froude"] for row in rows] == pytest.approx([1.25**2 / 8.38755, 2.25**2 / 8.38755], rel=1e-3)
    for row, stride in zip(rows, summary["strides"], strict=True):
        assert (row["method"], row["seed"], row["reason"]) == ("AI-CPG", 3, "")
        assert row["flight_ratio"] == pytest.approx(0.2)
        assert (row["symmetry_index"], row["balance_index"]) == (pytest.approx(0.0, abs=1e-3), pytest.approx(1.0))
        assert (row["survived"], row["falls_per_minute"]) == (1.0, 0.0)
        assert stride["stride_frequency_hz"] == pytest.approx(1.0, rel=1e-3) and stride["duty_factor"] == pytest.approx(
            0.4
        )
        sole = sole_heights(torch.tensor([0.0, 0.0, 0.88]), torch.tensor([0.0, 0.0, 0.0, 1.0]), torch.zeros(28)).amin()
        assert stride["sole_hover_m"] - stride["sole_penetration_m"] == pytest.approx(float(sole), abs=2e-4)


def test_the_same_again_gives_the_same_numbers(pattern):
    """To the bit, with physics in several threads, falls and pushes, on an engine that has been used before."""
    engine = make_engine("mujoco", 16, "cpu", motors(), Physics())
    first, second = (run(replace(DISTURBANCE, duration=3.0), engine, pattern, (0.9, 1.3)) for _ in range(2))
    assert first.fallen.any()
    for name, value in vars(first).items():
        if name != "terrain":
            assert torch.equal(value.nan_to_num(-1.0), vars(second)[name].nan_to_num(-1.0)), name


def test_falls_end_what_is_measured_and_are_counted(glider, pattern):
    """One of two robots falls after 3 s: it does not survive, but the second before still counts."""
    engine = glider(2)
    engine.fall_at = {1: 180}
    protocol = replace(SWEEP, duration=6.0, frequencies=(1.0,))
    trajectories = run(protocol, engine, pattern)
    assert trajectories.fallen.nonzero().tolist() == [[180, 1]]
    assert trajectories.settled.sum(dim=0).tolist() == [300, 120]
    assert trajectories.age[181, 1] == 0 and torch.isnan(trajectories.speed[181, 1])
    row = summaries.sweep_rows(trajectories, torch.tensor([1.0]), SOURCE)[0][0]
    assert row["survived"] == 0.5 and row["falls_per_minute"] == pytest.approx(5.0)
    assert row["speed_mps"] == pytest.approx(1.25, rel=1e-3)


def test_turning_away_is_not_a_fall(glider, pattern):
    """One of two robots turns away after 3 s: it has not fallen, and what comes after does not count either."""
    engine = glider(2)
    engine.turn_at = {1: 180}
    trajectories = run(replace(SWEEP, duration=6.0, frequencies=(1.0,)), engine, pattern)
    assert trajectories.turned.nonzero().tolist() == [[180, 1]] and not trajectories.fallen.any()
    assert torch.equal(trajectories.ended, trajectories.turned) and torch.equal(
        trajectories.failed, trajectories.turned
    )
    assert trajectories.settled.sum(dim=0).tolist() == [300, 120]
    row = summaries.sweep_rows(trajectories, torch.tensor([1.0]), SOURCE)[0][0]
    assert (row["survived"], row["falls_per_minute"], row["turned_away"]) == (1.0, 0.0, 0.5)
    assert row["turned_away_per_minute"] == pytest.approx(5.0)
    rows, summary = transition_summaries.transition_rows(trajectories, torch.tensor([1.0]), SOURCE)
    assert rows[-1]["standing"] == 0.5
    assert (summary["environments_that_never_fell"], summary["environments_that_never_turned_away"]) == (2, 1)
    assert summary["environments_that_got_through"] == 1


def test_the_edge_of_the_terrain_ends_an_episode_without_a_fall(glider, pattern):
    """The faster of two robots comes to the edge: it starts again, and only its way before counts."""
    terrain = Terrain.make(Ground(height_range=0.1, length=24.0, width=16.0))
    assert terrain is not None
    trajectories = run(replace(SWEEP, duration=6.0, frequencies=(1.0,)), glider(9, terrain), pattern)
    fast = 8
    first = int(trajectories.ended[:, fast].long().argmax())
    assert 60 < first < 400 and not trajectories.fallen.any()
    x = trajectories.root_position[..., 0]
    assert x[first, fast] > 22.9 and x[first + 1, fast] < 13.0
    assert int(trajectories.standing[:, fast].sum()) == first
    assert trajectories.age[first + 1, fast] == 0 and math.isnan(trajectories.speed[first + 1, fast])
    assert not trajectories.settled[first:, fast].any()
    assert torch.nanmean(trajectories.speed[:, fast]).item() == pytest.approx(5.0, rel=1e-3)
    row = summaries.sweep_rows(trajectories.among(torch.arange(9) == fast), torch.tensor([1.0]), SOURCE)[0][0]
    assert row["speed_mps"] == pytest.approx(5.0, rel=1e-3)
    assert (row["survived"], row["falls_per_minute"], row["reason"]) == (1.0, 0.0, "")
    rows, summary = transition_summaries.transition_rows(trajectories, torch.tensor([1.0]), SOURCE)
    assert rows[-1]["standing"] == 1.0
    assert summary["environments_that_never_fell"] == 9 > summary["environments_that_got_through"]
    heights = [pose["height_m"] for pose in summary["poses"]]
    assert max(abs(height - 0.88) for height in heights) > 0.005  # above the ground below, not above 0
    place = trajectories.root_position[59, 0]
    assert float(place[2] - trajectories.ground_height[59, 0]) == pytest.approx(0.88 - float(terrain.height(place)))


def test_everything_falls_at_once(glider, pattern):
    """Every protocol gives rows whose empty cells have a reason."""
    engine = glider(3)
    engine.state.root_position[:] = 0.0

    def falling(*arguments, **options) -> None:
        glider.step(engine, *arguments, **options)
        position = engine.state.root_position.clone()
        position[:, 2] = 0.2
        engine.state = replace(engine.state, root_position=position, joint_torque=position.new_full((3, 28), math.nan))

    engine.step = falling
    start = torch.tensor([0.7, 1.0, 1.3])
    trajectories = run(replace(SWEEP, duration=3.0, frequencies=(0.7, 1.0, 1.3)), engine, pattern)
    tables = {
        "sweep": summaries.sweep_rows(trajectories, start, SOURCE),
        "disturbance": summaries.disturbance_rows(trajectories, start, SOURCE),
        "transition": transition_summaries.transition_rows(trajectories, start[:1], SOURCE),
        "speed": summaries.speed_rows(trajectories, start, np.array([1.0, 2.0, 3.0]), SOURCE),
    }
    tables["command again"] = summaries.no_speeds(SOURCE)
    for name, (rows, _) in tables.items():
        for row in rows:
            empty = [key for key, value in row.items() if value is None or value != value]
            assert not empty or row["reason"], (name, row)
    assert tables["sweep"][0][0]["falls_per_minute"] == pytest.approx(3600.0)
    assert tables["sweep"][0][0]["survived"] == 0.0
    changes = tables["transition"][1]
    assert changes["flight_begins_hz"]["mean"] is None and "got through" in changes["flight_begins_hz"]["reason"]
    assert changes["poses"] == []


def test_a_disturbance_pushes_in_a_tenth_of_every_second(glider, pattern):
    """Forces on all axes, up to 200 N, in 6 steps of 60; falls per minute over all episodes."""
    engine = glider(4)
    engine.fall_at, engine.turn_at = {0: 100, 1: 200}, {1: 300}
    protocol = replace(DISTURBANCE, duration=10.0, frequencies=(0.8, 1.2))
    trajectories = run(protocol, engine, pattern)
    force = torch.stack([push for push in engine.pushed if push is not None])
    assert len(force) == 600
    assert ((force != 0).any(dim=2).sum(dim=0) - 60).abs().max() <= 6
    assert 150.0 < force.abs().max() <= 200.0 and (force.abs().amax(dim=(0, 1)) > 100.0).all()
    rows, _ = summaries.disturbance_rows(trajectories, torch.tensor([0.8, 1.2]), SOURCE)
    assert [row["falls_per_minute"] for row in rows] == pytest.approx([6.0, 0.0])
    assert [row["turned_away_per_minute"] for row in rows] == pytest.approx([3.0, 0.0])
    assert rows[1]["speed_mps"] == pytest.approx(2.25, rel=1e-3) and rows[0]["iteration"] == 100


def test_a_transition_raises_the_frequency(glider, pattern):
    """f(t) = 0.7 + 0.023 t; windows of 60 steps; the diagram shows an environment's feet."""
    trajectories = run(replace(TRANSITION, duration=8.0), glider(2), pattern)
    assert trajectories.frequency[300].tolist() == pytest.approx([0.815, 0.815], abs=1e-4)
    rows, summary = transition_summaries.transition_rows(trajectories, torch.tensor([0.7]), SOURCE)
    assert len(rows) == 480 and rows[-1]["time_s"] == pytest.approx(8.0)
    middle = rows[240]
    assert middle["speed_mps"] == pytest.approx(1.25, rel=1e-3)
    assert middle["speed_std_mps"] == pytest.approx(0.25, rel=1e-2)
    assert middle["flight_ratio"] == pytest.approx(0.2) and middle["reason"] == ""
    assert "full window" in rows[10]["reason"] and math.isnan(rows[10]["speed_mps"])
    walking = summary["gait_diagrams"]["walking"]
    assert walking["stride_frequency_hz"] == pytest.approx(1.0, rel=1e-3) and walking["flight_ratio"] == pytest.approx(
        0.2
    )
    assert len(summary["poses"]) == 11
    assert summary["gait_diagrams"]["running"]["reason"]  # this one ends before
    assert {(row["right_contact"], row["left_contact"]) for row in rows[60:120]} == {(1, 0), (0, 1), (0, 0)}


def test_gait_changes_by_hand():
    """Fr passes 0.5 at 2.048 m/s; flight comes in windows 1000 to 1099 and from 1300 on."""
    ramp = (0.7 + 0.023 * torch.arange(1800) / 60).unsqueeze(1).repeat(1, 2)
    everyone = torch.ones(2, dtype=torch.bool)
    speed = torch.linspace(1.0, 4.0, 1800).unsqueeze(1).repeat(1, 2)
    flight = torch.zeros(1800, 2)
    flight[1000:1100] = 0.1
    flight[1300:] = 0.2
    speed[:60], flight[:60] = math.nan, math.nan
    found = transition_summaries.gait_changes(ramp, speed, flight, everyone)
    assert found["transition_speed_mps"]["mean"] == pytest.approx(2.048, abs=2e-3)
    assert found["flight_begins_hz"]["mean"] == pytest.approx(0.7 + 0.023 * 1000 / 60, abs=1e-4)
    assert found["flight_is_steady_hz"]["mean"] == pytest.approx(0.7 + 0.023 * 1300 / 60, abs=1e-4)
    assert found["flight_begins_hz"]["environments"] == 2
    flight[-1] = 0.0
    found = transition_summaries.gait_changes(ramp, torch.full_like(speed, 1.0), flight, everyone)
    assert found["flight_is_steady_hz"]["reason"] and found["transition_speed_mps"]["reason"]


def test_up_and_down_again(glider, pattern):
    """F rises and falls by the same way; each way is read off by itself, in the direction of rising frequency."""
    protocol = replace(UP_AND_DOWN, duration=12.0)
    trajectories = run(protocol, glider(2), pattern)
    rate = 0.7 / 30.0
    assert trajectories.frequency[240].tolist() == pytest.approx([0.7 + 4 * rate] * 2, abs=1e-4)
    assert trajectories.frequency[[359, 361], 0].tolist() == pytest.approx([0.7 + rate * 359 / 60] * 2, abs=1e-4)
    assert trajectories.frequency[-1, 0] == pytest.approx(0.7 + rate / 60, abs=1e-4)
    # Speed that lags behind by a second, as if by inertia, passes 2.048 m/s later both ways.
    time = torch.arange(720) / 60
    lagging = 1.0 + 0.5 * torch.minimum(time - 1.0, 13.0 - time).clamp_min(0.0)
    trajectories = replace(trajectories, speed=lagging.unsqueeze(1).repeat(1, 2))
    rows, summary = transition_summaries.up_and_down_rows(trajectories, torch.tensor([0.7]), SOURCE)
    assert len(rows) == 720
    at = (2.048 - 1.0) / 0.5
    assert summary["up"]["transition_frequency_hz"]["mean"] == pytest.approx(0.7 + rate * (at + 1.0), abs=2e-3)
    assert summary["down"]["transition_frequency_hz"]["mean"] == pytest.approx(0.7 + rate * (at - 1.0), abs=2e-3)
    assert summary["hysteresis_hz"] == pytest.approx(2 * rate, abs=2e-3)


def test_from_running_to_walking(glider, pattern):
    """The change of gait is where the speed falls below the Froude number, at that frequency."""
    trajectories = run(replace(SLOWING, duration=12.0), glider(2), pattern)
    assert trajectories.frequency[300].tolist() == pytest.approx([1.39 - 0.023 * 5.0] * 2, abs=1e-4)
    falling = torch.linspace(4.0, 1.0, 720).unsqueeze(1).repeat(1, 2)
    _, summary = transition_summaries.slowing_rows(replace(trajectories, speed=falling), torch.tensor([1.39]), SOURCE)
    at = (4.0 - 2.048) / 3.0 * 12.0
    assert summary["transition_frequency_hz"]["mean"] == pytest.approx(1.39 - 0.023 * at, abs=2e-3)
    assert summary["environments_that_got_through"] == 2


def test_a_speed_becomes_a_frequency_by_the_sweeps_curve():
    """Straight between points, other seeds and falls left out, and the lowest frequency where speed drops."""
    points = [(0.7, 1.0, 3), (0.8, 1.5, 3), (0.9, math.nan, 3), (1.0, 1.4, 3), (1.1, 2.4, 3), (1.2, 9.0, 4)]
    rows = [
        {"method": "AI-CPG", "seed": seed, "frequency_hz": f, "speed_mps": v, "survived": float(v == v)}
        for f, v, seed in points
    ]
    rows.append({"method": "AI-CPG", "seed": 3, "frequency_hz": 1.3, "speed_mps": 7.0, "survived": 0.25})
    speeds, frequencies = summaries.speeds_to_command(rows, SOURCE, 8)
    assert speeds.tolist() == pytest.approx(np.linspace(1.0, 2.4, 8).tolist())
    assert frequencies[0] == 0.7 and frequencies[-1] == pytest.approx(1.1)
    assert np.interp(1.4, speeds, frequencies) == pytest.approx(0.78)
    assert (np.diff(frequencies) > 0).all()
    assert len(summaries.speeds_to_command(rows, Source("PPO", 3, 0), 8)[0]) == 0


def test_command_errors(glider, pattern):
    """Robots at 1 and 1.5 m/s told to do 1.2 and 1.5."""
    protocol = replace(SPEED, duration=4.0)
    trajectories = run(protocol, glider(2), pattern, frequencies=(0.8, 1.0))
    rows, summary = summaries.speed_rows(trajectories, torch.tensor([0.8, 1.0]), np.array([1.2, 1.5]), SOURCE)
    assert [row["error_mps"] for row in rows] == pytest.approx([-0.2, 0.0], abs=1e-3)
    assert summary["mean_absolute_error_mps"] == pytest.approx(0.1, abs=1e-3)
    assert summary["largest_absolute_error_mps"] == pytest.approx(0.2, abs=1e-3)
