"""rsl_rl's on-policy runner with this project's checkpoints: whole files, exact resume."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import torch
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch.utils.tensorboard import SummaryWriter

from aicpg_newton.device import torch_threads
from aicpg_newton.env import faults
from aicpg_newton.env.environment import Environment
from aicpg_newton.env.observations import differences, layout, mirror_of
from aicpg_newton.env.stored import to_dict
from aicpg_newton.env.task import Learning
from aicpg_newton.errors import UserError
from aicpg_newton.learning import bad_states, checkpoint, distributed, resuming
from aicpg_newton.learning.demonstration import Demonstration, log_film
from aicpg_newton.learning.ppo import BoundedPPO
from aicpg_newton.learning.settings import runner_settings


class TimeIsUp(Exception):
    """The time for a run is over; its last checkpoint has been written."""


_REASONS: dict[int, type[BaseException]] = {1: TimeIsUp, 2: KeyboardInterrupt}
"""Why several processes stop together; the greatest number counts."""


@contextmanager
def _threads_that_fail_quietly() -> Iterator[None]:
    """TensorBoard writes in a thread, whose failure the next value to be logged raises: once is enough."""
    before = threading.excepthook
    threading.excepthook = lambda failure: None if isinstance(failure.exc_value, OSError) else before(failure)
    try:
        yield
    finally:
        threading.excepthook = before


class Runner(OnPolicyRunner):
    """Trains the reflex network of an environment, or loads one to play.

    Args:
        environment: The environment; its task holds the learning settings.
        run: Facts about the run that go into every checkpoint (number of environments, engine, seed, revision).
        folder: Where logs and checkpoints go; None to log and save nothing.
        seconds: Time after which the next checkpoint is the last [s].
        device: Device of the networks; None for the environment's.
        logger: Where curves go, as :func:`aicpg_newton.learning.settings.runner_settings` takes it.
    """

    env: Environment
    alg: BoundedPPO

    def __init__(
        self,
        environment: Environment,
        run: dict[str, Any],
        folder: Path | None = None,
        seconds: float = math.inf,
        device: torch.device | None = None,
        logger: str = "tensorboard",
    ) -> None:
        self.run = run
        self._deadline = time.monotonic() + seconds
        self._reason_to_stop = 0
        self.has_learned = False
        """Whether there is anything to save that was not there before."""
        settings = runner_settings(environment.task, mirror_of(environment.blocks), run["seed"], logger)
        log_dir = None if folder is None else str(folder)
        super().__init__(environment, settings, log_dir=log_dir, device=str(device or environment.device))
        self.logger.git_status_repos = []  # the run keeps what is to be kept of its code
        self.logger.log = self._and_then(self.logger.log)
        self.demonstration: Demonstration | None = None
        """What shows at every checkpoint how robots walk and run; None for nothing."""
        self.film_every = 0
        """Every how many demonstrations are filmed; 0 for none."""
        self._dumped = 0
        self._stops = False
        self._iteration = 0
        self.alg.update = torch_threads(torch.get_num_threads())(self._checked(self.alg.update))

    def _configure_multi_gpu(self) -> None:
        """As many processes as :func:`distributed.joined` has met, whatever the environment's variables say."""
        self.gpu_global_rank, self.gpu_world_size = distributed.rank(), distributed.size()
        self.is_distributed = self.gpu_world_size > 1
        places = {"global_rank": self.gpu_global_rank, "world_size": self.gpu_world_size}
        self.cfg["multi_gpu"] = places if self.is_distributed else None

    def stop_together(self) -> None:
        """Stop before the next update, in all processes that train together; they agree on it then."""
        self._reason_to_stop = 2

    def stop_soon(self) -> None:
        """End with a checkpoint when the iteration is over; asked once more, at once."""
        if self._stops:
            raise KeyboardInterrupt
        self._stops = True
        with suppress(OSError):  # print cannot be called again while it prints
            os.write(2, b"\nStops when the iteration is over; once more stops at once.\n")

    def obey(self, wanted: Learning, before: Learning) -> None:
        """Take settings that a checkpoint's own state would overrule: the learning rate and the exploration.

        Args:
            wanted: Settings of this run.
            before: Settings that the checkpoint was trained with; where they are the same, its state goes on.
        """
        fixed_now = wanted.learning_rate_schedule == "fixed" != before.learning_rate_schedule
        if wanted.learning_rate != before.learning_rate or fixed_now:
            self.alg.learning_rate = wanted.learning_rate
        else:
            self.alg.learning_rate = self.alg.optimizer.param_groups[0]["lr"]  # within the bounds of this run
        if wanted.initial_std != before.initial_std:
            distribution: Any = self.alg.actor.distribution
            with torch.no_grad():
                distribution.log_std_param.fill_(math.log(wanted.initial_std))

    def _checked(self, update: Callable[[], dict[str, float]]) -> Callable[[], dict[str, float]]:
        """An update that learns from nothing that is not a number, where nobody wants to stop."""

        def checked() -> dict[str, float]:
            reason = distributed.greatest(self._reason_to_stop)
            if reason:
                raise _REASONS[reason]
            self.env.check()
            self.alg.begin_iteration(self._iteration)
            self._iteration += 1
            if self.logger.writer is not None:  # nobody else empties this list
                self.logger.ep_extras.append({"Learning/rate": torch.tensor(self.alg.learning_rate)})
            losses = update()
            self.has_learned = True
            return losses

        return checked

    def _and_then(self, log: Callable[..., None]) -> Callable[..., None]:
        """The log of an iteration, and then what else is due at its end."""

        def logged(*, it: int, **facts: Any) -> None:
            with suppress(OSError) if self._stops else nullcontext():  # the terminal may be gone
                log(it=it, **facts)
                self._tell_of_faults(it)
                self._demonstrate(it)
            if self._stops:
                self.current_learning_iteration = it
                self.save(str(Path(self.logger.log_dir or "") / f"model_{it}.pt"))
                raise KeyboardInterrupt

        return logged

    def _demonstrate(self, iteration: int) -> None:
        """Show where a training stands, at every checkpoint but the first and the last."""
        interval = self.cfg["save_interval"]
        if self.demonstration is None or self._stops or iteration % interval or not iteration:
            return
        measures = self.demonstration(lambda observed: self.decide(observed).cpu())
        writer = self.logger.writer
        for name, value in measures.items():
            if writer is not None:
                writer.add_scalar(name, value, iteration)
        print("".join(f"{name + ':':>40} {value:.4f}\n" for name, value in measures.items()))
        if self.film_every and (iteration // interval) % self.film_every == 0:
            for film in self.demonstration.film(iteration):
                if isinstance(writer, SummaryWriter):
                    log_film(writer, film, iteration)

    def _tell_of_faults(self, iteration: int) -> None:
        """Log, say and, where that is asked for, write down whose simulation went wrong in an iteration."""
        counts = self.env.faults.take()
        for cause, number in counts.items():
            if self.logger.writer is not None:
                self.logger.writer.add_scalar(f"Faults/{cause}", number, iteration)
        said = faults.sentence(counts)
        if not said:
            return
        print(said)
        if self.env.bad_states is None or self.logger.log_dir is None:
            return
        robots = {name: rows[: bad_states.MOST - self._dumped] for name, rows in self.env.bad_states.take().items()}
        self._dumped += len(robots["cause"])
        path = Path(self.logger.log_dir) / f"bad_states_{iteration}.pt"
        task, engine = to_dict(self.env.task), self.env.engine.name
        bad_states.write(path, robots, task=task, engine=engine, iteration=iteration)
        print(f"Step them again:  python -m aicpg_newton.bad_states --file {path}")
        if self._dumped >= bad_states.MOST:
            self.env.bad_states = None
            print(f"That makes {bad_states.MOST}; no more are written down.")

    @torch_threads(1)
    def learn(self, num_learning_iterations: int, init_at_random_ep_len: bool = False) -> None:
        """Collect on one torch thread and update on all, iteration after iteration.

        Args:
            num_learning_iterations: Number of iterations to do.
            init_at_random_ep_len: Begin with episodes of random age, so that they do not all end at once.

        Raises:
            TimeIsUp: The time given to this run is over.
            KeyboardInterrupt: See :meth:`stop_together` and :meth:`stop_soon`.
            UserError: The disk takes no log or no checkpoint.
        """
        self._iteration = self.current_learning_iteration
        try:
            with _threads_that_fail_quietly():
                super().learn(num_learning_iterations, init_at_random_ep_len)
        except BrokenPipeError:
            raise  # nobody reads the console any more
        except OSError as error:
            raise UserError(
                f"cannot write the log in {self.logger.log_dir} ({error.strerror or error}); make room and continue"
                " with --resume, from the last checkpoint"
            ) from error

    def save(self, path: str, infos: dict | None = None) -> None:
        """Write a checkpoint when an iteration is over, and beside it the rest of the state.

        Raises:
            TimeIsUp: The time given to this run is over; several processes first have to agree on that.
        """
        if self.is_distributed:
            self.save_networks(path)
        else:
            resuming.write(self, Path(path))
            try:
                self.save_networks(path)
            except UserError:
                resuming.beside(Path(path)).unlink(missing_ok=True)  # makes room, and belongs to nothing
                raise
            resuming.drop_older(Path(path))
        if time.monotonic() > self._deadline and self.is_distributed:
            self._reason_to_stop = max(self._reason_to_stop, 1)
        elif time.monotonic() > self._deadline:
            raise TimeIsUp

    def save_networks(self, path: str) -> None:
        """Write a checkpoint of what has been learned so far, also within an iteration."""
        checkpoint.write(
            Path(path),
            task=to_dict(self.env.task),
            observations=layout(self.env.blocks),
            pattern=self.env.pattern.content(),
            run=self.run,
            iteration=self.current_learning_iteration + 1,
            samples=self.logger.tot_timesteps,
            algorithm=self.alg.save(),
        )

    def restore(self, content: dict[str, Any]) -> None:
        """Continue from a checkpoint: networks, normalisers, optimiser with its learning rate, iteration, samples.

        Args:
            content: What :func:`checkpoint.read` returned.

        Raises:
            UserError: The checkpoint's networks have other sizes than the task's settings.
        """
        self._load(content, None)
        self.current_learning_iteration = content["iteration"]
        self.logger.tot_timesteps = content["samples"]

    def take_networks(self, content: dict[str, Any], *names: str) -> None:
        """Take networks of a checkpoint and nothing else, to play or to begin another run with.

        Args:
            content: What :func:`checkpoint.read` returned.
            names: ``actor`` and ``critic`` or one of them, each with its normaliser.

        Raises:
            UserError: The checkpoint's networks have other sizes than the task's settings.
        """
        self._load(content, dict.fromkeys(names, True))

    def _load(self, content: dict[str, Any], parts: dict[str, bool] | None) -> None:
        different = differences(content.get("observations", []), layout(self.env.blocks))
        if "observations" in content and different:
            raise UserError(
                f"the checkpoint's networks see other observations: {different}; use the code that trained it, or train"
                " again"
            )
        try:
            self.alg.load(content["algorithm"], load_cfg=parts, strict=True)
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            learning = content["task"]["learning"]
            sizes = " ".join(map(str, learning["hidden_sizes"]))
            raise UserError(
                "the checkpoint's networks do not fit the settings; keep its method and give --learning.network"
                f" {learning.get('network', 'mlp')} --learning.hidden-sizes {sizes} --learning.activation"
                f" {learning['activation']}, as it was trained with"
            ) from error

    def decide(self, observed: TensorDict) -> torch.Tensor:
        """Actions without exploration, shape [num_envs, 28], on the environment's device; goes on training after it."""
        return self.alg.get_policy()(observed.to(self.device)).to(self.env.device)

    def policy(self) -> torch.nn.Module:
        """The reflex network for deterministic use: observations [num_envs, 192] to actions [num_envs, 28]."""
        return self.get_inference_policy(str(self.env.device))
