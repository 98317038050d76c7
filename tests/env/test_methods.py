"""The registry of methods."""

import pytest

from aicpg_newton.env.actuation import Actuation
from aicpg_newton.env.methods import METHODS, get_method, with_method
from aicpg_newton.env.registry import TASKS, get_task
from aicpg_newton.env.rewards import pattern_terms
from aicpg_newton.errors import UserError


def test_an_unknown_method_is_named():
    """With the ones there are."""
    with pytest.raises(UserError, match=r"unknown method 'sac'; choose one of: ai-cpg, ppo, amp"):
        get_method("sac")
    with pytest.raises(UserError, match="unknown method"):
        get_task("flat", "sac")


def test_methods_are_told_apart():
    """Titles and ways of control differ; only AI-CPG follows the stride frequency."""
    assert len({method.title for method in METHODS.values()}) == len(METHODS)
    assert all(issubclass(method.actuation, Actuation) for method in METHODS.values())
    assert [name for name, method in METHODS.items() if method.follows_frequency] == ["ai-cpg"]


def test_a_task_with_a_method_is_a_new_task():
    """The registry's own settings are left alone."""
    plain = TASKS["uneven"]()
    with_method(plain, "ppo")
    assert plain == TASKS["uneven"]()


def test_a_task_may_weigh_a_methods_term():
    """It stays where the method has it, and is left out where another has."""
    task = TASKS["robust"]()
    task.rewards |= pattern_terms()
    task.rewards["pattern_tracking"].weight = 8.0
    assert with_method(task, "ai-cpg").rewards["pattern_tracking"].weight == 8.0
    assert "pattern_tracking" not in with_method(task, "ppo").rewards
    assert with_method(task, "ppo").rewards["target_speed"].weight == 5.0
    assert list(get_task("flat").rewards)[-1] == "pattern_tracking"
    assert "pattern_tracking" not in TASKS["flat"]().rewards
