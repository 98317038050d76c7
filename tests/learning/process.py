"""One of several processes that train together; a script that test_distributed.py starts.

python process.py FOLDER train METHOD      a short training; its networks go to FOLDER/<rank>.pt
python process.py FOLDER update METHOD     an update on this process's part of samples that are the same every time
"""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
from rsl_rl.utils import resolve_class
from tensordict import TensorDict

from aicpg_newton import launcher
from aicpg_newton.env.registry import get_task
from aicpg_newton.env.task import ImitationTask, Task
from aicpg_newton.errors import run_command
from aicpg_newton.gait.cpg import PatternNetwork
from aicpg_newton.learning import distributed
from aicpg_newton.learning.amp import AdversarialMotionPriors
from aicpg_newton.learning.plan import RunOptions
from aicpg_newton.learning.runner import Runner
from aicpg_newton.learning.settings import runner_settings
from aicpg_newton.learning.training import train
from aicpg_newton.robot.humanoid import NUM_JOINTS
from aicpg_newton.robot.mirror import Mirror

STEPS, NUM_ENVS, SIZE, STYLE = 4, 8, 6, 81


def small_task(method: str) -> Task:
    """The flat task with little learning."""
    task = get_task("flat", method)
    task.learning.hidden_sizes = (16, 16)
    task.learning.steps_per_iteration = STEPS
    task.learning.epochs, task.learning.minibatches = 2, 1
    if isinstance(task, ImitationTask):
        task.imitation.discriminator_hidden_sizes = (16, 8)
        task.imitation.discriminator_batch = 8
    return task


def trained(folder: Path, method: str) -> dict[str, Any]:
    """Networks and optimisers after a training of three iterations."""
    kept: list[Runner] = []
    original = Runner.learn

    def learn(self: Runner, *arguments: Any, **others: Any) -> None:
        kept.append(self)
        original(self, *arguments, **others)

    Runner.learn = learn  # type: ignore[method-assign]
    where = folder / "run"
    train(small_task(method), RunOptions(num_envs=4, device="cpu", max_iterations=3, run_dir=where, seed=3))
    frequencies = kept[0].env.commands.frequency.tolist()
    return {**kept[0].alg.save(), "frequencies": frequencies, "rate": kept[0].alg.learning_rate}


def updated(method: str) -> dict[str, Any]:
    """Networks after an update by plain gradient descent on this process's part of the samples."""
    rank, size = distributed.rank(), distributed.size()
    torch.manual_seed(0)
    mine = NUM_ENVS // size
    observed = {"policy": torch.randn(STEPS + 1, NUM_ENVS, SIZE) * 3 + 1}
    if method == "amp":
        observed["style"] = torch.randn(STEPS + 1, NUM_ENVS, STYLE)
    samples = TensorDict(observed, batch_size=[STEPS + 1, NUM_ENVS])[:, rank::size]
    actions, rewards = torch.randn(STEPS, NUM_ENVS, NUM_JOINTS), torch.randn(STEPS, NUM_ENVS)
    dones = torch.rand(STEPS, NUM_ENVS) < 0.1
    task = small_task(method).for_environments(NUM_ENVS)
    task.learning.learning_rate_schedule, task.learning.network, task.learning.symmetry = "fixed", "mlp", False
    task.learning.learning_rate = task.learning.maximum_learning_rate = 0.02
    settings = runner_settings(task, Mirror(tuple(range(SIZE)), (1.0,) * SIZE), 0)
    settings["algorithm"]["optimizer"] = "sgd"
    settings["multi_gpu"] = {"global_rank": rank, "world_size": size} if size > 1 else None
    environment = SimpleNamespace(num_envs=mine, num_actions=NUM_JOINTS, pattern=PatternNetwork.load())
    algorithm, _ = resolve_class(dict(settings["algorithm"]))
    torch.manual_seed(1)
    learner: Any = algorithm.construct_algorithm(samples[0], environment, settings, "cpu")
    if size > 1:
        learner.broadcast_parameters()
    learner.train_mode()
    with torch.inference_mode():
        for step in range(STEPS):
            learner.act(samples[step])
            chosen = actions[step, rank::size]
            learner.transition.actions = chosen
            learner.transition.actions_log_prob = learner.actor.get_output_log_prob(chosen)
            learner.process_env_step(samples[step + 1], rewards[step, rank::size], dones[step, rank::size].long(), {})
        learner.compute_returns(samples[STEPS])
    if isinstance(learner, AdversarialMotionPriors):  # it draws at random: here all there is, in every process
        reference = learner.reference
        learner._draw = lambda pairs, number: reference[:1].repeat(number, 1, 1) if pairs is reference else pairs
        plain: Any = torch.optim.SGD(learner.discriminator.parameters(), lr=0.01)
        learner.discriminator_optimizer = plain
    learner.update()
    return learner.save()


def main() -> None:
    """Do what the command line says."""
    folder, what = Path(sys.argv[1]), sys.argv[2]
    if what == "train":
        rank = launcher.place().rank
        torch.save(trained(folder, sys.argv[3]), folder / f"{rank}.pt")
        return
    with distributed.joined():
        after = {method: updated(method) for method in ("ai-cpg", "amp")}
        torch.save(after, folder / f"{distributed.rank()}_of_{distributed.size()}.pt")


if __name__ == "__main__":
    run_command(main, alone=False)
