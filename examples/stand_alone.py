"""Walk 20 s and run 20 s on what the export wrote: python examples/stand_alone.py DIR.

It needs MuJoCo, ONNX Runtime and numpy, and nothing of this package: pip install mujoco onnxruntime.
"""

# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false
import sys
from collections.abc import Iterator

import mujoco
import numpy as np
import onnxruntime

CONTROL_DT, SUBSTEPS, TURN_RATE = 1 / 60, 4, 0.25  # [s], physics steps in it, how fast f is turned [Hz/s]


class Robot:
    """One humanoid in MuJoCo and its controller, a control step of 1/60 s at a time."""

    def __init__(self, folder: str, start: str = "walk") -> None:
        self.model = mujoco.MjModel.from_xml_path(f"{folder}/humanoid.xml")
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key(start).id)
        self.controller = onnxruntime.InferenceSession(f"{folder}/controller.onnx")
        self.wrench = np.zeros((2, 2, 3))  # force and moment of the ground, each on the right and on the left foot
        self.joint_torque, self.reflex_torque, self.phase = np.zeros(28), np.zeros(28), 0.0

    def step(self, frequency: float) -> None:
        """Ask the controller, then let physics go on for 1/60 s."""
        qpos, qvel = self.data.qpos, self.data.qvel
        measured = {
            "root_position": qpos[:3],
            "root_rotation": qpos[3:7],
            "root_linear_velocity": qvel[:3],
            "root_angular_velocity": qvel[3:6],
            "joint_position": qpos[7:],
            "joint_velocity": qvel[6:],
            "joint_torque": self.joint_torque,
            "foot_force": self.wrench[0],
            "foot_moment": self.wrench[1],
            "ground_height": 0.0,
            "phase": self.phase,
            "frequency": frequency,
            "heading": 0.0,
            "last_reflex_torque": self.reflex_torque,
        }
        inputs = {name: np.asarray(value, np.float32)[None] for name, value in measured.items()}
        target, rate, self.reflex_torque, phase = (each[0] for each in self.controller.run(None, inputs))
        self.phase = float(phase)
        self.data.ctrl[:] = np.concatenate((target, rate, self.reflex_torque))
        self.wrench[:] = 0.0
        for _ in range(SUBSTEPS):
            mujoco.mj_step(self.model, self.data)
            # Of each foot: its force on the ground, the moment of that about a point, the point, the foot's origin.
            force, moment, point, origin = self.data.sensordata[:24].reshape(2, 4, 3).swapaxes(0, 1)
            self.wrench -= np.stack((force, moment + np.cross(point - origin, force))) / SUBSTEPS
        self.joint_torque = self.data.sensordata[24:52].copy()


def walk_and_run(robot: Robot, stages: tuple[float, ...] = (0.9, 1.3), seconds: float = 20.0) -> Iterator[float]:
    """Go through stride frequencies [Hz], each for some time [s]; gives the present one after every control step."""
    frequency, most = stages[0], TURN_RATE * CONTROL_DT
    for stage in stages:
        way = []
        for _ in range(round(seconds / CONTROL_DT)):
            frequency += np.clip(stage - frequency, -most, most)
            robot.step(frequency)
            if robot.data.qpos[2] < 0.55:
                sys.exit(f"fell at f = {frequency:.2f} Hz")
            way.append(robot.data.qpos[0])
            yield frequency
        print(f"f = {stage:.2f} Hz: {(way[-1] - way[len(way) // 2]) / (0.5 * seconds):.2f} m/s, no fall")


if __name__ == "__main__":
    list(walk_and_run(Robot(sys.argv[1])))
