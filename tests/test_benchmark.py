"""The benchmark measures what it says, and its table can be read."""

import pytest

from aicpg_newton.benchmark import BenchmarkOptions, Rates, benchmark, table
from aicpg_newton.errors import UserError


def test_rates_of_an_engine(capsys: pytest.CaptureFixture):
    """All rates are positive on both grounds, and no environment is faster than its engine by more than noise."""
    rows = benchmark(BenchmarkOptions(num_envs=(8,), engines=("mujoco",), device="cpu", seconds=0.2, iterations=1))
    assert [(row.engine, row.task, row.num_envs) for row in rows] == [("mujoco", "flat", 8), ("mujoco", "uneven", 8)]
    for row in rows:
        assert row.bare is not None and row.learning is not None
        assert min(row.bare, row.engine_alone, row.environment, row.learning, row.build) > 0
        assert row.environment < 1.2 * row.engine_alone
    printed = capsys.readouterr().out
    assert "| mujoco | flat | 8 |" in printed and "| mujoco | uneven | 8 |" in printed


def test_newton_reports_its_buffers():
    """Contacts and constraints were counted, and nothing overflowed."""
    rows = benchmark(BenchmarkOptions(num_envs=(4,), engines=("newton",), device="cpu", seconds=0.1, iterations=0))
    for row in rows:
        contacts, constraints, *_, overflows = (float(word.split()[0]) for word in row.buffers.split(", "))
        assert contacts > 0
        assert constraints > 0
        assert overflows == 0
        assert row.learning is None


def test_table_is_worked_out_from_the_rates():
    """Shares by hand: the engine is 75 % of the bare loop, and 40 % of the environment's time is outside it."""
    row = Rates("newton", "flat", 256, 3.0, 2000.0, 1500.0, 900.0, None, "-")
    assert table([row]).splitlines()[-1] == "| newton | flat | 256 | 3.0 | 2,000 (75%) | 1,500 | 900 | 40% | - | - |"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_envs": ()}, "--num-envs"),
        ({"num_envs": (4, 0)}, "--num-envs"),
        ({"seconds": 0.0}, "--seconds"),
        ({"engines": ("bullet",)}, "bullet"),
        ({"tasks": ("moon",)}, "moon"),
        ({"tasks": ()}, "--tasks is empty"),
    ],
)
def test_bad_options(changes: dict, message: str):
    """One sentence each."""
    with pytest.raises(UserError, match=message):
        benchmark(BenchmarkOptions(**{"device": "cpu", **changes}))
