"""Where the energy goes: python scripts/cost_of_transport.py CHECKPOINT. The table of docs/robust.md comes from here.

Splits the cost of transport (Eq. 12), integrated over the physics steps, into work that motors do and work that they
take up, and puts beside it, in the same unit, what the passive damping of the joints eats (at the joint velocities at
the end of each control step): motors have to supply it, Eq. 12 does not name it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import on_task
from aicpg_newton.env.registry import get_task
from aicpg_newton.errors import UserError, run_command
from aicpg_newton.evaluation.protocols import FREQUENCIES
from aicpg_newton.evaluation.run import Laboratory
from aicpg_newton.learning.policy import Trained, load_policy
from aicpg_newton.playing.rollout import Tally, physical_frames, share_out
from aicpg_newton.robot.humanoid import CONTROL_RATE, GRAVITY, JOINT_NAMES, TOTAL_MASS, joint_group

NUM_ENVS = 60
STEPS = round(10 * CONTROL_RATE)
WARM_UP = round(2 * CONTROL_RATE)
"""Control steps at the start that do not count."""

LEGS = ("hip", "knee", "ankle")


def main() -> None:
    """Measure on a plane and print a row for each stride frequency."""
    if len(sys.argv) != 2:
        raise UserError("give one checkpoint, as assets/policies/robust.pt")
    trained = Trained.read(Path(sys.argv[1]))
    task = on_task(trained.task, get_task("flat")).undisturbed()
    task.termination.episode_steps = STEPS + 1
    engine = Laboratory(device="cpu").engine_of(task, NUM_ENVS)
    environment = Environment(task, engine, trained.pattern)
    group = share_out(NUM_ENVS, len(FREQUENCIES))
    environment.restart(torch.tensor(FREQUENCIES)[group])
    tally = Tally(environment.commands.frequency)
    damping = environment.motors.damping
    # Sums over time: motors driving, motors braking and damping, per joint [W]; and speed [m/s].
    driving, braking, damped = torch.zeros(3, NUM_ENVS, len(JOINT_NAMES))
    speed = torch.zeros(NUM_ENVS)
    agent = load_policy(environment, trained.content)
    for step, _ in enumerate(physical_frames(environment, agent, STEPS, tally)):
        if step < WARM_UP:
            continue
        state = environment.outcome.state
        measures = engine.measures()
        driving += measures.driving_power
        braking += measures.braking_power
        damped += damping * state.joint_velocity.square()
        speed += state.root_linear_velocity[:, 0]
    print(f"{'f [Hz]':>7}{'v [m/s]':>9}{'CoT':>7}{'drive':>7}{'brake':>7}{'damping':>9}", end="")
    print("".join(f"{name:>7}" for name in LEGS) + f"{'stride [m]':>12}{'falls':>7}")
    legs = torch.tensor([[joint_group(joint) == leg for joint in JOINT_NAMES] for leg in LEGS])
    for number, frequency in enumerate(FREQUENCIES):
        mine = group == number
        way = TOTAL_MASS * GRAVITY * speed[mine].sum()
        costs = [float(each[mine].sum() / way) for each in (driving + braking, driving, braking, damped)]
        parts = [float((driving + braking)[mine][:, leg].sum() / way) for leg in legs]
        mean = float(speed[mine].mean()) / (STEPS - WARM_UP)
        print(f"{frequency:7.2f}{mean:9.2f}" + "".join(f"{cost:7.3f}" for cost in costs[:3]), end="")
        print(f"{costs[3]:9.3f}" + "".join(f"{part:7.3f}" for part in parts), end="")
        print(f"{mean / frequency:12.2f}{int(tally.falls[mine].sum()):7d}")


if __name__ == "__main__":
    run_command(main)
