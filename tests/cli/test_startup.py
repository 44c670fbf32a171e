"""What a command imports, and that nobody waits for a compiler unawares."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CORRIDOR = str(ROOT / "missions" / "corridor.yaml")
NEVER = {"rerun", "zenoh", "pymavlink", "cvxpy", "networkx", "matplotlib", "mcap", "malipp_field.control"}
HEAVY = NEVER | {"numba", "scipy", "highspy"}


def loaded(*arguments: str) -> tuple[set[str], str]:
    """Run a command in a process of its own; return the modules it had in the end, and its stderr."""
    code = (
        "import sys\n"
        "from malipp_field.cli.app import main\n"
        "try:\n    main()\n"
        "finally:\n    print('MODULES', *sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True, timeout=200
    )
    return set(done.stdout.rpartition("MODULES")[2].split()), done.stderr


@pytest.fixture(scope="module")
def warmed() -> None:
    """What `make setup` does."""
    subprocess.run([sys.executable, "-m", "malipp_field.planner.warm"], check=True, timeout=200)


@pytest.mark.parametrize("method", ["auto", "no-handoffs", "seq"])
@pytest.mark.usefixtures("warmed")
def test_planning_imports_nothing_it_does_not_need_and_compiles_nothing(method: str, tmp_path: Path) -> None:
    modules, said = loaded("plan", CORRIDOR, "-o", str(tmp_path / "plan.json"), "--method", method)
    assert not NEVER & modules
    assert "scipy.linalg" not in modules or method == "seq"
    assert "compiling" not in said


def test_a_command_that_does_not_plan_imports_no_solver(tmp_path: Path) -> None:
    plan = str(tmp_path / "plan.json")
    loaded("plan", CORRIDOR, "-o", plan, "--method", "no-handoffs")
    assert not (HEAVY | {"malipp_field.planner", "malipp_field.mission"}) & loaded("--help")[0]
    assert not (HEAVY - {"highspy"}) & loaded("verify", CORRIDOR, plan)[0]
    exported = loaded("export", CORRIDOR, plan, "--format", "plan", "-o", str(tmp_path))[0]
    assert not (HEAVY - {"highspy", "pymavlink"}) & exported


def test_compiling_is_told_once(tmp_path: Path) -> None:
    (tmp_path / "some_kernels.py").write_text(
        "from malipp_field.planner.kernels import njit\n\n\n"
        "@njit(cache=True)\ndef twice(x):\n    return 2 * x\n\n\n"
        "@njit(cache=True)\ndef thrice(x):\n    return 3 * x\n\n\n"
        "print(twice(1) + thrice(1))\n"
    )

    def run() -> tuple[str, int]:
        done = subprocess.run(
            [sys.executable, "-c", "import some_kernels"],
            cwd=tmp_path, capture_output=True, text=True, check=True, timeout=200,
        )  # fmt: skip
        return done.stdout.strip(), done.stderr.count("compiling")

    assert run() == ("5", 1)
    assert run() == ("5", 0)  # from the disk now
