"""Play a controller: in a live viewer, into a recording or a filmstrip, and always into a table."""

from __future__ import annotations

from aicpg_newton.env.task import Task
from aicpg_newton.playing.options import PlayOptions
from aicpg_newton.playing.rollout import Tally
from aicpg_newton.playing.sources import SOURCES, Basis


def play(options: PlayOptions, task: Task) -> Tally:
    """Let an agent move, show it, and print speed, falls and episode length per frequency.

    Args:
        options: What to play and where to see it.
        task: The task that ``options.task`` names; if it names none, that of agents without a checkpoint.

    Raises:
        UserError: An option cannot be met.
    """
    options = options.settled()
    steps = options.steps()
    motion = SOURCES[options.agent](options, Basis.of(options, task), steps)
    from aicpg_newton.playing.outputs import outputs_of  # here: viewers take seconds to load, and options may be wrong

    with outputs_of(options, motion) as outputs:
        for step, frame in enumerate(motion.frames, start=1):
            if not all([output.take(frame, step) for output in outputs]):
                break
    if motion.turned:
        print("The stride frequency was turned by hand; f in the table is what it was at the start.")
    print(motion.tally.table())
    return motion.tally
