"""What stands around the physics as a few compiled kernels does what it does step by step."""

import shutil
from pathlib import Path

import pytest
import torch
from torch._inductor import config as inductor
from torch._inductor.scheduler import BaseSchedulerNode, ExternKernelSchedulerNode

from aicpg_newton import device
from aicpg_newton.engines import make_engine
from aicpg_newton.engines.interface import BodyState
from aicpg_newton.env import environment as module
from aicpg_newton.env.environment import Environment, engine_for
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import Task
from aicpg_newton.errors import UserError
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning.runner import Runner

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="torch.compile needs a C++ compiler on a CPU")

NUM_ENVS = 8


@pytest.fixture(autouse=True)
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Kernels that are counted are compiled here, not found in a cache."""
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))
    torch._dynamo.reset()
    yield
    torch._dynamo.reset()


def small(task: Task) -> Task:
    """The same with less terrain, where it has any."""
    if task.ground.uneven:
        task.ground.length, task.ground.width = 24.0, 16.0 * task.ground.levels
    return task


def pair(task: Task, name: str, pattern: PatternNetwork) -> tuple[Environment, Environment]:
    """The same environment plain and compiled."""
    plain, compiled = (
        Environment(task, engine_for(task, name, NUM_ENVS, "cpu"), pattern, seed=3, compiled=each)
        for each in (False, True)
    )
    return plain, compiled


def assert_same_steps(plain: Environment, compiled: Environment, steps: int = 24) -> None:
    """The compiled one takes up the plain one's state before each step, and its physics the plain one's inputs.

    A foot that touches the ground magnifies their rounding, so both are held to the same motion.
    """
    inputs: list[dict] = []
    first, second = plain.engine.step, compiled.engine.step

    def noted(target, target_velocity, torque, *, push=None) -> None:
        inputs.append({"target": target, "target_velocity": target_velocity, "torque": torque, "push": push})
        first(**inputs[-1])

    def same(target, target_velocity, torque, *, push=None) -> None:
        given = {"target": target, "target_velocity": target_velocity, "torque": torque, "push": push}
        for name, value in inputs[-1].items():
            assert (given[name] is None) == (value is None)
            if value is not None:
                torch.testing.assert_close(given[name], value, atol=1e-4, rtol=1e-4)
        second(**inputs[-1])

    plain.engine.step, compiled.engine.step = noted, same  # type: ignore[method-assign]
    for step in range(steps):
        compiled.load_state_dict(plain.state_dict())
        actions = 0.3 * torch.randn(NUM_ENVS, 28, generator=torch.Generator().manual_seed(step))
        if step == steps // 2:  # some fall
            state = plain.engine.state
            low = {each: getattr(state, each).clone() for each in BodyState.__dataclass_fields__}
            low["root_position"][:3, 2] -= 2.0
            for each in (plain, compiled):
                each.engine.reset(torch.arange(NUM_ENVS) < 3, BodyState(**low))
        expected, found = plain.step(actions), compiled.step(actions)
        assert set(found[0].keys()) == set(expected[0].keys())
        for name, seen in expected[0].items():
            torch.testing.assert_close(found[0][name], seen, atol=1e-3, rtol=1e-3)
        torch.testing.assert_close(found[1], expected[1], atol=1e-5, rtol=1e-4)
        assert torch.equal(found[2], expected[2]) and torch.equal(found[3]["time_outs"], expected[3]["time_outs"])
        assert found[2].sum() >= 3 * (step == steps // 2)
        for name, value in expected[3]["log"].items():
            torch.testing.assert_close(found[3]["log"][name], value, atol=1e-4, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "most", "products"), [("ai-cpg", 28, 3), ("amp", 38, 0)])
def test_compiled_steps_are_the_plain_ones(
    method: str, most: int, products: int, pattern: PatternNetwork, monkeypatch: pytest.MonkeyPatch
):
    """On a plane, with falls; compiled whole, or it would be refused.

    Beside them two copies of the state are launched, after the physics and after a reset; of 40 launches at most.
    """
    kernels = []
    monkeypatch.setattr(device, "reading_is_free", lambda _: False)  # with the options for a GPU

    def count(nodes: list[BaseSchedulerNode]) -> list[BaseSchedulerNode]:
        kernels.extend(not isinstance(each, ExternKernelSchedulerNode) for each in nodes)
        return nodes

    with inductor.patch(_post_fusion_custom_pass=count):
        plain, compiled = pair(get_task("flat", method), "newton", pattern)
        compiled.step(torch.zeros(NUM_ENVS, 28))
    matrix_products = len(kernels) - sum(kernels)
    print(f"{sum(kernels)} fused kernels and {matrix_products} matrix products a step and reset")
    assert 15 < sum(kernels) <= most and matrix_products == products  # 23 and 32
    assert_same_steps(plain, compiled)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), [("robust", "ai-cpg"), ("uneven", "amp"), ("flat", "ppo")])
def test_all_methods_and_grounds(name: str, method: str, pattern: PatternNetwork):
    """Terrain, levels, pushes and frequencies that change; targets of a network; torques alone."""
    assert_same_steps(*pair(small(get_task(name, method)), "mujoco", pattern))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), [("flat", "ai-cpg"), ("robust", "ai-cpg"), ("uneven", "amp")])
def test_nothing_is_compiled_twice(name: str, method: str, pattern: PatternNetwork):
    """Learning steps in inference mode and on one thread; playing does not. torch compiles anew for what differs."""
    task = small(get_task(name, method))
    task.learning.steps_per_iteration = 4
    with torch._dynamo.config.patch(error_on_recompile=True):
        environment = Environment(task, engine_for(task, "mujoco", NUM_ENVS, "cpu"), pattern, compiled=True)
        runner = Runner(environment, {"seed": 0})
        runner.learn(2, init_at_random_ep_len=True)
        environment.restart(environment.commands.frequency)
        for _ in range(2):
            environment.step(torch.zeros(NUM_ENVS, 28))
        environment.faults.take()
        environment.load_state_dict(environment.state_dict())
        runner.learn(1)


def test_on_a_gpu_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch):
    """Where launching kernels takes longer than they do, if there is what compiles them."""
    gpu, cpu = torch.device("cuda:0"), torch.device("cpu")
    monkeypatch.setattr(device, "find_spec", lambda name: name)
    assert device.worth_compiling("auto", gpu) and not device.worth_compiling("auto", cpu)
    assert device.worth_compiling("on", cpu) and not device.worth_compiling("off", gpu)
    monkeypatch.setattr(device, "find_spec", lambda name: None)
    assert not device.worth_compiling("auto", gpu)


def test_no_compiler(monkeypatch: pytest.MonkeyPatch, pattern: PatternNetwork):
    """One sentence that says what to do."""

    def broken(owner, names, place):
        def fail(*_):
            raise RuntimeError("no working C++ compiler found\nand a long story")

        for name in names:
            setattr(owner, name, fail)

    task = get_task("flat")
    monkeypatch.setattr(module, "compile_methods", broken)
    engine = make_engine("mujoco", 2, "cpu", task.motors(), task.physics)
    with pytest.raises(UserError, match=r"does not work here \(no working C\+\+ compiler found\); give --compile off"):
        Environment(task, engine, pattern, compiled=True)
