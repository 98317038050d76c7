"""The humanoid as a stock MuJoCo model: the training engine's, with plain names and motors for the controller."""

# The type checker cannot see into MuJoCo's compiled module.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import torch

from aicpg_newton.engines.mujoco import MujocoEngine, add_sensors
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.gait.poses import gait_start
from aicpg_newton.robot.humanoid import FOOT_NAMES, JOINT_NAMES, LINK_NAMES, Motors


def stock_model(engine: MujocoEngine, motors: Motors, pattern: PatternNetwork) -> str:
    """The engine's model as MJCF for MuJoCo as it comes, in Python, C or a browser.

    Three motors a joint take the controller's outputs as they are: ``ctrl`` holds the 28 target angles, their 28 rates
    and the 28 reflex torques, and the joint limits the sum. Sensors are the engine's: of the right and the left foot
    its force on the ground, the moment of that, the point it is about and the foot frame's origin, then the motor
    torque of each joint. Keyframes, one for each imitated gait, stand in it at phase 0 and at its speed.

    Args:
        engine: The engine, of the package's own humanoid.
        motors: Its motors.
        pattern: The pattern network S, which knows the gaits.
    """
    spec = engine.spec.copy()
    for each in (*spec.sensors, *spec.actuators, *spec.excludes):  # no two links are made to touch in the first place
        spec.delete(each)
    for body, name in zip(spec.bodies[1:], LINK_NAMES, strict=True):
        assert body.name.endswith(name)
        body.name = name
    root, *hinges = spec.joints
    root.name = "root"
    for joint, name in zip(hinges, JOINT_NAMES, strict=True):
        assert name in joint.name
        joint.name = name
    for geom in spec.geoms:
        geom.name = geom.name.rsplit("/", 1)[-1].rsplit("_", 1)[0]
    spec.modelname = "aicpg_humanoid"
    _pave(spec)
    add_sensors(spec, FOOT_NAMES, JOINT_NAMES)
    for gait in pattern.gaits:
        frequency = torch.tensor([gait.frequency])
        start = gait_start(pattern, torch.zeros(1), frequency, pattern.nominal_speed(frequency))
        qpos, qvel = engine.coordinates(start)
        spec.add_key(name=gait.name, qpos=qpos[0].numpy(), qvel=qvel[0].numpy())
    spec.compile()
    return _add_motors(spec.to_xml(), motors)


def _add_motors(text: str, motors: Motors) -> str:
    """Put a position servo, a velocity servo and a torque motor for every joint into the file, in blocks.

    As elements of their own kind, which every MuJoCo reads: its own writer turns them into a general form that differs
    between versions.
    """
    root = ElementTree.fromstring(text)
    actuators = ElementTree.SubElement(root, "actuator")
    gains = {"position": ("kp", motors.position_gain), "velocity": ("kv", motors.velocity_gain), "motor": None}
    for kind, gain in gains.items():
        for index, joint in enumerate(JOINT_NAMES):
            motor = ElementTree.SubElement(actuators, kind, name=f"{joint}_{kind}", joint=joint)
            if gain is not None:
                motor.set(gain[0], f"{float(gain[1][index]):g}")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _pave(spec: mujoco.MjSpec) -> None:
    """Draw the plane without end and with tiles of a metre, so that motion is seen; to physics it is the same."""
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.86, 0.88, 0.90],
        rgb2=[0.78, 0.81, 0.84],
        width=256,
        height=256,
    )
    textures = [""] * mujoco.mjtTextureRole.mjNTEXROLE
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    spec.add_material(name="tiles", textures=textures, texrepeat=[0.5, 0.5], texuniform=True)
    for geom in spec.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.size, geom.material, geom.rgba = [0.0, 0.0, 1.0], "tiles", [1.0, 1.0, 1.0, 1.0]
