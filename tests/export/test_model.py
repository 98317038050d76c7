"""The stock model against the training engine's."""

# The type checker cannot see into MuJoCo's compiled module.
# pyright: reportAttributeAccessIssue=false

from pathlib import Path

import mujoco
import numpy as np
import pytest

from aicpg_newton.engines.interface import Physics
from aicpg_newton.engines.mujoco import MujocoEngine
from aicpg_newton.export.model import stock_model
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.robot import humanoid

# Names, what MuJoCo counts, and what follows from the motors, which are laid out in another way.
_OTHER = ("name_", "names", "actuator_", "key_", "exclude_", "mat_", "tex_", "geom_rgba", "geom_matid", "geom_size")
_COUNTS = ("nbuffer", "nnames", "nnames_map", "nexclude", "nkey", "nmat", "ntex", "ntexdata", "nu", "nout", "nJmom")
_COUNTS += ("nactuator", "nbuffer", "signature")


@pytest.fixture(scope="module")
def engine() -> MujocoEngine:
    """The training engine."""
    return MujocoEngine(1, "cpu", humanoid.motors(), Physics())


@pytest.fixture(scope="module")
def stock(engine: MujocoEngine) -> mujoco.MjModel:
    """The stock model, read from text as anyone would."""
    text = stock_model(engine, humanoid.motors(), PatternNetwork.load())
    return mujoco.MjModel.from_xml_string(text)


def test_every_field_is_that_of_the_engine(engine: MujocoEngine, stock):
    """Masses, inertias, joints, contacts, sensors and options; the file has six digits."""
    compared = 0
    for name in dir(engine.model):
        own, other = getattr(engine.model, name), getattr(stock, name)
        if name.startswith(("_", *_OTHER)) or name in _COUNTS or not isinstance(own, (int, float, np.ndarray)):
            continue
        compared += 1
        np.testing.assert_allclose(other, own, rtol=1e-5, atol=1e-6, err_msg=name)
    assert compared > 200
    for name in (each for each in dir(engine.model.opt) if not each.startswith("_")):
        np.testing.assert_allclose(getattr(stock.opt, name), getattr(engine.model.opt, name), rtol=1e-5, err_msg=name)


def test_names_are_those_of_the_package(stock):
    """Joints and motors in the package's order."""
    assert [stock.joint(i).name for i in range(1, stock.njnt)] == list(humanoid.JOINT_NAMES)
    assert [stock.body(i).name for i in range(1, stock.nbody)] == list(humanoid.LINK_NAMES)
    assert stock.actuator(28 + 3).name == "neck_x_velocity" and stock.actuator(2 * 28).name == "abdomen_x_motor"


def test_motors_move_it_as_the_engine_is_moved(engine: MujocoEngine, stock):
    """A tenth of a second of random targets, rates and torques, some beyond the limit, from the same pose."""
    random = np.random.default_rng(0)
    target, rate, torque = random.normal(0, 0.5, 28), random.normal(0, 5, 28), random.normal(0, 80, 28)
    data, own = mujoco.MjData(stock), mujoco.MjData(engine.model)
    mujoco.mj_resetDataKeyframe(stock, data, 0)
    own.qpos[:], own.qvel[:] = data.qpos, data.qvel
    data.ctrl[:] = np.concatenate((target, rate, torque))
    own.ctrl[engine._position_inputs] = target + torque / engine._position_gain
    own.ctrl[engine._velocity_inputs] = rate
    for _ in range(24):
        mujoco.mj_step(stock, data)
        mujoco.mj_step(engine.model, own)
    limit = humanoid.motors().torque_limit.numpy()
    assert (np.abs(data.sensordata[24:]) > 0.9999 * limit).any()
    np.testing.assert_allclose(data.qpos, own.qpos, atol=1e-4)
    np.testing.assert_allclose(data.sensordata[24:], own.sensordata[24:], atol=0.1)


def test_keyframes_stand_on_the_ground(exported: Path):
    """Walk and run: the lowest sole touches and nothing is sunk."""
    model = mujoco.MjModel.from_xml_path(str(exported / "humanoid.xml"))
    data = mujoco.MjData(model)
    for key, least in (("walk", 1.0), ("run", 2.5)):
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
        mujoco.mj_forward(model, data)
        depths = [contact.dist for contact in data.contact[: data.ncon]]
        assert min(depths, default=0.0) > -1e-3
        assert data.qvel[0] > least
