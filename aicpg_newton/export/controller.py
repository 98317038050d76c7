"""The whole controller as one module, from what is measured on a robot to what its motors are told; as ONNX."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch
from torch import nn

from aicpg_newton.engines import RobotState
from aicpg_newton.engines.mujoco import MujocoEngine
from aicpg_newton.env.commands import Commands
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.methods import get_method
from aicpg_newton.env.observations import layout, observe
from aicpg_newton.env.view import View
from aicpg_newton.errors import UserError
from aicpg_newton.files import WholeFile
from aicpg_newton.gait.cpg import advance_phase
from aicpg_newton.learning.policy import Trained, load_network
from aicpg_newton.robot import rotations
from aicpg_newton.robot.fingerprint import fingerprint
from aicpg_newton.robot.humanoid import CONTROL_RATE, JOINT_NAMES, NUM_JOINTS

INPUTS: dict[str, tuple[tuple[int, ...], str]] = {
    "root_position": ((3,), "origin of the pelvis frame in the world [m]"),
    "root_rotation": ((4,), "rotation of the pelvis, quaternion (w, x, y, z) of any length"),
    "root_linear_velocity": ((3,), "velocity of the pelvis frame's origin, world frame [m/s]"),
    "root_angular_velocity": ((3,), "angular velocity of the pelvis, pelvis frame [rad/s]"),
    "joint_position": ((NUM_JOINTS,), "joint angles [rad]"),
    "joint_velocity": ((NUM_JOINTS,), "joint velocities [rad/s]"),
    "joint_torque": ((NUM_JOINTS,), "motor torques of the last physics step [N m]"),
    "foot_force": ((2, 3), "force of the ground on the right and left foot, mean of the last step, world frame [N]"),
    "foot_moment": ((2, 3), "its moment about the ankle, the foot frame's origin, world frame [N m]"),
    "ground_height": ((), "world height of the ground below the pelvis [m]"),
    "phase": ((), "phase of the rhythm generator [rad]: next_phase of the last step"),
    "frequency": ((), "stride frequency f [Hz]"),
    "heading": ((), "yaw of the direction to go in, in the world [rad]"),
    "last_reflex_torque": ((NUM_JOINTS,), "reflex_torque of the last step [N m]; zero before the first"),
}
"""Inputs in order: shape without the number of robots, which leads, and meaning.

Root and joints are as MuJoCo holds them in qpos and qvel. A value that is not finite stands for what it is at rest
(see :meth:`Controller.forward`), and nothing counts as larger than :data:`LARGEST`.
"""

LARGEST = 1e6
"""Larger inputs are taken for this, so that no output overflows; nothing that is measured is as large."""

OUTPUTS: dict[str, tuple[tuple[int, ...], str]] = {
    "target": ((NUM_JOINTS,), "target angles theta_t of the PD law [rad]"),
    "target_velocity": ((NUM_JOINTS,), "their rate [rad/s]"),
    "reflex_torque": ((NUM_JOINTS,), "tau_r, torque on top of the PD law [N m]; the motor limits the sum"),
    "next_phase": ((), "phase of the rhythm generator a control step later [rad]"),
}
"""Outputs in order, in the same way."""


def sound(measured: torch.Tensor, otherwise: torch.Tensor | float = 0.0) -> torch.Tensor:
    """What is measured, within +-:data:`LARGEST`; where it is not finite, something else."""
    return torch.where(torch.isfinite(measured), measured, otherwise).clamp(-LARGEST, LARGEST)


class Controller(nn.Module):
    """A control step of AI-CPG without a robot: the package's own functions one behind the other.

    Args:
        trained: The trained network.

    Raises:
        UserError: It is a baseline, which no stride frequency controls, or does not fit this version.
    """

    def __init__(self, trained: Trained) -> None:
        super().__init__()
        method = get_method(trained.task.method)
        if not method.follows_frequency:
            raise UserError(
                f"{trained.path} was trained as {method.title}, which has no stride frequency to turn;"
                " only AI-CPG networks can be exported"
            )
        task = trained.task.undisturbed()
        self.engine = MujocoEngine(1, "cpu", task.motors(), task.physics)
        """One robot on a plane; only the network's sizes and the stock model are taken from it."""
        environment = Environment(task, self.engine, trained.pattern)
        self.task = task
        self.motors = environment.motors
        self.blocks = environment.blocks
        self.actuation = environment.actuation
        self.pattern = environment.pattern
        self.network = load_network(environment, trained.content).requires_grad_(False)

    def forward(
        self,
        root_position: torch.Tensor,
        root_rotation: torch.Tensor,
        root_linear_velocity: torch.Tensor,
        root_angular_velocity: torch.Tensor,
        joint_position: torch.Tensor,
        joint_velocity: torch.Tensor,
        joint_torque: torch.Tensor,
        foot_force: torch.Tensor,
        foot_moment: torch.Tensor,
        ground_height: torch.Tensor,
        phase: torch.Tensor,
        frequency: torch.Tensor,
        heading: torch.Tensor,
        last_reflex_torque: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """:data:`INPUTS` to :data:`OUTPUTS`, each with a leading number of robots; finite for any input."""
        walk = self.pattern.gaits[0]
        ground_height, heading, phase = map(sound, (ground_height, heading, phase))
        frequency = sound(frequency, walk.frequency)
        upright = ground_height.unsqueeze(1) + root_position.new_tensor((0.0, 0.0, walk.root_harmonics[0][2]))
        root_position = sound(root_position, upright)
        root_linear_velocity, root_angular_velocity = map(sound, (root_linear_velocity, root_angular_velocity))
        joint_position, joint_velocity, joint_torque = map(sound, (joint_position, joint_velocity, joint_torque))
        foot_force, foot_moment, last_reflex_torque = map(sound, (foot_force, foot_moment, last_reflex_torque))
        rotation = rotations.normalised(root_rotation.roll(-1, dims=-1), rotations.about_z(heading))
        state = RobotState(
            root_position=root_position,
            root_rotation=rotation,
            root_linear_velocity=root_linear_velocity,
            root_angular_velocity=rotations.rotate(rotation, root_angular_velocity),
            joint_position=joint_position,
            joint_velocity=joint_velocity,
            joint_torque=joint_torque,
            head_position=root_position,  # for a reward alone
            foot_force=foot_force,
            foot_moment=foot_moment,
        )
        commands = Commands(frequency, heading)
        self.actuation.follow(phase, commands)
        view = View(
            state=state,
            ground_height=ground_height,
            commands=commands,
            terrain=None,
            motors=self.motors,
            torque=last_reflex_torque,
            torque_unit=self.actuation.torque_unit,
            target=self.actuation.target,
            target_velocity=self.actuation.target_velocity,
        )
        actions = self.network({"policy": observe(self.blocks, view)})
        command = self.actuation.command(actions, state)
        return command.target, command.target_velocity, command.torque, advance_phase(phase, frequency)

    def facts(self) -> dict[str, str]:
        """What stands in the file beside the network; lists and tables as JSON."""
        frequencies = self.task.frequencies
        motors = {name: values.tolist() for name, values in asdict(self.motors).items()}
        facts = {
            "joint_names": list(JOINT_NAMES),
            **{name: [round(value, 6) for value in values] for name, values in motors.items()},
            "motor_units": "gains [N m/rad] and [N m s/rad], limit [N m], damping [N m s/rad], armature [kg m^2]",
            "control_rate": CONTROL_RATE,
            "physics_rate": CONTROL_RATE * self.task.physics.substeps,
            "frequency_range": [frequencies.minimum, frequencies.maximum],
            "inputs": {name: meaning for name, (_, meaning) in INPUTS.items()},
            "outputs": {name: meaning for name, (_, meaning) in OUTPUTS.items()},
            "observations": layout(self.blocks),
            "frames": "x forward, y left, z up; right is -y",
            "humanoid": fingerprint(),
        }
        return {name: each if isinstance(each, str) else json.dumps(each) for name, each in facts.items()}


def write_onnx(controller: Controller, paths: Sequence[Path]) -> None:
    """Write a controller for any number of robots at once; tracing takes a while, so to several places at once too.

    Raises:
        UserError: The disk does not take the file.
    """
    example = tuple(torch.rand(2, *shape) for shape, _ in INPUTS.values())
    robots = {0: torch.export.Dim("robots")}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of the exporter, about itself
        program = torch.onnx.export(
            controller.eval(),
            example,
            input_names=list(INPUTS),
            output_names=list(OUTPUTS),
            dynamic_shapes=dict.fromkeys(INPUTS, robots),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    for node in program.model.graph:  # they name the files of this machine
        node.metadata_props.clear()
    program.model.metadata_props.update(controller.facts())
    for path in paths:
        with WholeFile(path) as temporary:
            program.save(str(temporary), external_data=False)
