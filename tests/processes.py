"""Commands in processes of their own, and what processes there are, from /proc."""

import atexit
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
# Other people's packages that are slow to import, torch._dynamo with the first optimizer; not those that register
# environments when they are imported.
SLOW = [
    "gymnasium", "torch", "torch._dynamo", "pandas", "pyarrow.parquet", "scipy.stats", "matplotlib.figure",
    "stable_baselines3", "numba", "tyro", "jinja2", "PIL.Image",
]  # fmt: skip


def variables(own: dict[str, str]) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **own}


def ended(
    *arguments: object, cwd: Path = ROOT, stdin: str | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A Python of its own with these arguments and variables, once it has ended, with all that holds its output."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(
        command,
        cwd=cwd,
        env=variables(environment),
        input=stdin,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def python(*arguments: object, **options: Any) -> str:
    """What a Python of its own prints, as `ended`; it must end well."""
    done = ended(*arguments, **options)
    assert done.returncode == 0, f"{done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


def python_again(*arguments: object, cwd: Path = ROOT) -> str:
    """As `python`, in a copy of a process that has imported SLOW and nothing of the project: it starts at once."""
    context = get_context("forkserver")
    context.set_forkserver_preload(SLOW)
    with tempfile.TemporaryDirectory() as folder:
        printed = [Path(folder, name) for name in ("stdout", "stderr")]
        process = context.Process(target=_call, args=(list(map(str, arguments)), str(cwd), printed))
        process.start()
        process.join(300)
        process.kill()
        said, errors = (path.read_text() if path.exists() else "" for path in printed)
    assert process.exitcode == 0, f"{process.exitcode}: {said[-2000:]}{errors[-2000:]}"
    return said


def _call(arguments: list[str], cwd: str, printed: list[Path]) -> None:
    """What Python does with these arguments."""
    for number, path in enumerate(printed, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    os.chdir(cwd)
    sys.argv = arguments[:1] + arguments[2:] if arguments[0] == "-c" else arguments
    sys.path[:0] = ["" if arguments[0] == "-c" else str(Path(arguments[0]).parent), str(ROOT)]
    try:
        if arguments[0] == "-c":
            sys.modules["__main__"] = main = ModuleType("__main__")
            exec(arguments[1], main.__dict__)
        else:
            runpy.run_path(arguments[0], run_name="__main__")
    finally:
        atexit._run_exitfuncs()


def started(*arguments: object, **environment: str) -> subprocess.Popen[str]:
    """As `ended`, but while it runs: a process group of its own, to which Ctrl-C means something."""
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        env=variables(environment),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests in the background ignore it
    )


def children(parent: int, word: str = "") -> list[int]:
    """Living processes that a process has started, with this word in their command line."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            owner = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            line = (path / "cmdline").read_bytes()
        except OSError:
            continue
        if owner == parent and word.encode() in line and is_alive(int(path.name)):
            found.append(int(path.name))
    return found


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def ends(pid: int) -> bool:
    """Whether a process ends soon."""
    wait_for(lambda: not is_alive(pid), 30.0)
    return True


def descriptors(pid: int | None = None) -> int:
    """Number of open file descriptors of a process, this one by default."""
    return len(os.listdir(f"/proc/{pid or 'self'}/fd"))


def wait_for(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
