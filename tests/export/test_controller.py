"""The exported controller against the package."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aicpg_newton.engines.terrain import Ground
from aicpg_newton.env.actuation import PatternActuation
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.errors import UserError
from aicpg_newton.export import controller as exporting
from aicpg_newton.export import requirements
from aicpg_newton.export.controller import INPUTS, OUTPUTS, Controller
from aicpg_newton.gait.cpg import pd_torque
from aicpg_newton.learning import checkpoint
from aicpg_newton.learning.policy import Trained, load_policy
from aicpg_newton.robot import humanoid, rotations

NUM_ROBOTS, NUM_STEPS = 5, 20

Values = dict[str, torch.Tensor]


@pytest.fixture(scope="module")
def recorded() -> tuple[Values, Values, torch.Tensor]:
    """100 states of the package's own control steps on uneven ground: inputs, outputs, and the CPG's torque [N m]."""
    trained = Trained.read(checkpoint.best_for("robust"))
    ground = Ground(height_range=0.08, length=48.0, width=16.0, seed=3)
    task = replace(trained.task.undisturbed(), ground=ground)
    environment = Environment(task, engine_for(task, "mujoco", NUM_ROBOTS, "cpu"), trained.pattern, seed=1)
    agent = load_policy(environment, trained.content)
    environment.restart(torch.linspace(0.75, 1.35, NUM_ROBOTS))
    environment.command(heading=torch.linspace(-0.3, 0.3, NUM_ROBOTS))
    actuation = environment.actuation
    assert isinstance(actuation, PatternActuation) and environment.engine.terrain is not None
    rows: list[tuple[Values, Values, torch.Tensor]] = []
    for step in range(NUM_STEPS + 1):
        state, last_torque, phase, commands = (
            environment.engine.state,
            actuation.torque,
            environment.phase,
            environment.commands,
        )
        target, rate = actuation.target, actuation.target_velocity
        assert rate is not None
        inputs = {
            "root_position": state.root_position,
            "root_rotation": state.root_rotation.roll(1, dims=1),
            "root_linear_velocity": state.root_linear_velocity,
            "root_angular_velocity": rotations.rotate(
                rotations.conjugate(state.root_rotation), state.root_angular_velocity
            ),
            "joint_position": state.joint_position,
            "joint_velocity": state.joint_velocity,
            "joint_torque": state.joint_torque,
            "foot_force": state.foot_force,
            "foot_moment": state.foot_moment,
            "ground_height": environment.engine.terrain.height(state.root_position),
            "phase": phase,
            "frequency": commands.frequency,
            "heading": commands.heading,
            "last_reflex_torque": last_torque,
        }
        motors = environment.motors
        gains = {"position_gain": motors.position_gain, "velocity_gain": motors.velocity_gain}
        cpg = pd_torque(target, rate, state.joint_position, state.joint_velocity, **gains)
        environment.command(frequency=commands.frequency + 0.004)
        environment.step(agent(environment.get_observations()["policy"]))
        outputs = {"target": target, "target_velocity": rate, "reflex_torque": environment.outcome.torque}
        outputs["next_phase"] = environment.outcome.phase
        if step:  # the heading that was told comes into force with the second step
            rows.append((inputs, outputs, cpg))
    every_input, every_output, torques = zip(*rows, strict=True)
    return (
        {name: torch.cat([row[name] for row in every_input]) for name in INPUTS},
        {name: torch.cat([row[name] for row in every_output]) for name in OUTPUTS},
        torch.cat(torques),
    )


@pytest.fixture(scope="module")
def session(exported: Path):
    """The exported controller in ONNX Runtime."""
    import onnxruntime

    return onnxruntime.InferenceSession(exported / "controller.onnx")


def ask(session, inputs: Values) -> Values:
    """What ONNX Runtime makes of inputs."""
    answers = session.run(list(OUTPUTS), {name: each.numpy() for name, each in inputs.items()})
    return {name: torch.from_numpy(answer) for name, answer in zip(OUTPUTS, answers, strict=True)}


@pytest.fixture(scope="module")
def answered(session, recorded: tuple[Values, Values, torch.Tensor]) -> Values:
    """What ONNX Runtime makes of the recorded states."""
    return ask(session, recorded[0])


def test_torques_are_those_of_the_package(recorded: tuple[Values, Values, torch.Tensor], answered: Values):
    """On 100 recorded states within 1e-4 N m, of the reflex and of the CPG; the phases within rounding."""
    inputs, outputs, cpg_torque = recorded
    motors = humanoid.motors()
    gains = {"position_gain": motors.position_gain, "velocity_gain": motors.velocity_gain}
    cpg = pd_torque(
        answered["target"], answered["target_velocity"], inputs["joint_position"], inputs["joint_velocity"], **gains
    )
    assert len(cpg) == 100 and inputs["foot_force"][..., 2].max() > 200 and outputs["reflex_torque"].abs().max() > 20
    print({name: float((answered[name] - outputs[name]).abs().max()) for name in OUTPUTS})
    torch.testing.assert_close(answered["reflex_torque"], outputs["reflex_torque"], rtol=0.0, atol=1e-4)
    torch.testing.assert_close(cpg, cpg_torque, rtol=0.0, atol=1e-4)
    torch.testing.assert_close(answered["next_phase"], outputs["next_phase"], rtol=0.0, atol=1e-6)


def test_onnx_runtime_and_torch_agree(recorded: tuple[Values, Values, torch.Tensor], answered: Values):
    """On the recorded states to 1e-5 of each output's largest value."""
    controller = Controller(Trained.read(checkpoint.best_for("robust")))
    for name, value in zip(OUTPUTS, controller(*recorded[0].values()), strict=True):
        largest = float(value.abs().max())
        torch.testing.assert_close(answered[name], value, rtol=0.0, atol=1e-5 * largest, msg=name)


@pytest.mark.parametrize("name", INPUTS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3e38, -3e38])
def test_outputs_are_finite_for_any_input(session, recorded: tuple[Values, Values, torch.Tensor], name: str, value):
    """One number of one input, or all of it; the other robots of the call get the same bits as without."""
    inputs = recorded[0]
    clean = ask(session, inputs)
    for place in (0, slice(None)):
        broken = {key: each.clone() for key, each in inputs.items()}
        broken[name].view(len(broken[name]), -1)[0, place] = value
        answers = ask(session, broken)
        for output, answer in answers.items():
            assert torch.isfinite(answer).all(), output
            assert torch.equal(answer[1:], clean[output][1:]), output


def test_everything_broken_at_once_is_finite(session):
    """And what is fed back, phase and reflex torque, is sound again for the next sample."""
    broken = {name: torch.full((1, *shape), math.nan) for name, (shape, _) in INPUTS.items()}
    answers = ask(session, broken)
    assert all(torch.isfinite(answer).all() for answer in answers.values())
    assert 0.0 <= float(answers["next_phase"]) < 2 * math.pi


def test_a_quaternion_of_another_length_is_the_same_attitude(session, recorded: tuple[Values, Values, torch.Tensor]):
    """Rounding and an estimator's drift change nothing; those of length 0 are upright and face the heading."""
    inputs = recorded[0]
    clean = ask(session, inputs)["reflex_torque"]
    for length in (1e-15, 0.5, 1.01, 1.1, 2.0, 1e30):
        answer = ask(session, {**inputs, "root_rotation": inputs["root_rotation"] * length})["reflex_torque"]
        torch.testing.assert_close(answer, clean, rtol=0.0, atol=1e-3)
    upright = rotations.about_z(inputs["heading"]).roll(1, dims=1)
    nothing = ask(session, {**inputs, "root_rotation": torch.zeros_like(upright)})
    expected = ask(session, {**inputs, "root_rotation": upright})
    assert torch.equal(nothing["reflex_torque"], expected["reflex_torque"])


def test_the_file_says_what_it_is(exported: Path):
    """Joints, motors, rates and the layout of the observations."""
    import onnx

    facts = {each.key: each.value for each in onnx.load(exported / "controller.onnx").metadata_props}
    assert json.loads(facts["joint_names"]) == list(humanoid.JOINT_NAMES)
    assert json.loads(facts["torque_limit"]) == humanoid.motors().torque_limit.tolist()
    assert json.loads(facts["control_rate"]) == 60 and json.loads(facts["physics_rate"]) == 240
    assert sum(size for _, size in json.loads(facts["observations"])) == 192
    assert json.loads(facts["inputs"]).keys() == INPUTS.keys()


def test_the_file_names_no_folder_of_this_machine(exported: Path):
    """PyTorch notes the source of every operation; a page that is shown to others should not."""
    content = (exported / "controller.onnx").read_bytes()
    assert str(Path(exporting.__file__).parents[2]).encode() not in content
    assert str(Path(torch.__file__).parent).encode() not in content


@pytest.mark.parametrize("baseline", ["flat_ppo_1.5.pt", "flat_amp_walk.pt"])
def test_baselines_are_refused(baseline: str):
    """They have no stride frequency to turn."""
    with pytest.raises(UserError, match="which has no stride frequency to turn"):
        Controller(Trained.read(humanoid.ASSETS / "policies" / baseline))


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Before any work is done."""
    monkeypatch.setattr(requirements, "_EXTRA", ("onnx", "no_such_package"))
    with pytest.raises(UserError, match=r"needs no_such_package; run: pip install -e \"\.\[export\]\""):
        requirements.check_packages()
