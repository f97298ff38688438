"""The wheel: what it installs, and that nothing beside a user's script can take the place of a part of it."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from functools import partial
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

SCRIPT = """
import gymnasium as gym
import sumo_env
for id in sumo_env.IDS:
    env = gym.make(id)
    env.reset(seed=0)
    env.step(1)
    env.close()
envs = gym.make(id), gym.make(id)  # one in this process, one in a worker
for env in envs:
    env.reset(seed=0)
    env.step(1)
for env in envs:
    env.close()
print(sumo_env.__file__)
"""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkout, copied without results: a build leaves its files there."""
    hidden = shutil.ignore_patterns(".*", "results")
    return shutil.copytree(ROOT, tmp_path_factory.mktemp("copy") / "source", symlinks=True, ignore=hidden)


@pytest.fixture(scope="module")
def python(source: Path) -> Path:
    """An environment's interpreter, with the wheel installed and its dependencies borrowed from ours."""
    folder = source.parent
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    options = ["--no-deps", "--no-index"]
    # without PYTHONPATH, in which pip would take the checkout for an installation
    run = partial(subprocess.run, check=True, cwd=folder, env=clean_environment())
    run([*pip, "wheel", *options, "--no-build-isolation", "-w", folder, source])
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "venv", with_pip=False)
    interpreter = folder / "venv" / "bin" / "python"
    run([*pip, "--python", interpreter, "install", *options, wheel])
    # only now: pip would find our own installation there, and might leave the wheel out
    (site_packages(interpreter) / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    return interpreter


def clean_environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def site_packages(interpreter: Path) -> Path:
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    return interpreter.parents[1] / "lib" / version / "site-packages"


def test_only_sumo_env_is_installed(python: Path) -> None:
    installed = {path.name for path in site_packages(python).iterdir()} - {"dependencies.pth"}
    assert {name for name in installed if not name.endswith(".dist-info")} == {"sumo_env"}
    networks = site_packages(python) / "sumo_env" / "networks"
    assert (networks.parent / "benchmark.json").is_file()
    assert networks.is_dir()
    assert not networks.is_symlink()


def test_hostile_files_beside_the_script_change_nothing(python: Path, tmp_path: Path) -> None:
    hostile = "raise RuntimeError('this is not the module that you are looking for')\n"
    for name in ("networks.py", "agents.py", "tests.py", "experiments/__init__.py", "sumo/__init__.py"):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(hostile)
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [python, script], cwd=tmp_path, env=clean_environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(site_packages(python))


def test_a_clone_without_symbolic_links_is_whole(python: Path, source: Path, tmp_path: Path) -> None:
    """Git makes such clones on Windows: a file is in the place of the link."""
    link = source / "sumo_env" / "networks"
    link.unlink()
    try:
        link.write_text("../networks")
        script = tmp_path / "script.py"
        script.write_text(SCRIPT)
        environment = {**clean_environment(), "PYTHONPATH": str(source)}
        run = partial(subprocess.run, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert Path(run([sys.executable, script], env=environment).stdout.strip()).is_relative_to(source)
        build = f"from setuptools import build_meta; print(build_meta.build_wheel({str(tmp_path)!r}))"
        run([sys.executable, "-c", build], cwd=source)
    finally:
        link.unlink()
        link.symlink_to("../networks")
    with_link, without = (
        {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("sumo_env/")}
        for folder in (source.parent, tmp_path)
        for wheel in folder.glob("*.whl")
    )
    assert sorted(without ^ with_link) == [] and "sumo_env/networks/u_turn/u_turn.net.xml" in without


def test_addresses_are_filled_in_at_once(tmp_path: Path) -> None:
    names = [
        "pyproject.toml",
        "CITATION.cff",
        "mkdocs.yml",
        "docs/templates/README.md.j2",
        "sumo_env/unsupported.py",
    ]
    for name in [*names, "Makefile"]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    assert subprocess.run(["make", "addresses"], cwd=tmp_path, capture_output=True).returncode
    command = ["make", "addresses", "REPOSITORY=https://a.example/me/it", "DOCUMENTATION=https://b.example"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    texts = [(tmp_path / name).read_text(encoding="utf-8") for name in names]
    assert not any("address: " in text or "REPOSITORY" in text for text in texts)
    urls = tomllib.loads(texts[0])["project"]["urls"]
    assert (urls["Repository"], urls["Documentation"]) == ("https://a.example/me/it", "https://b.example")
    assert "\nrepository-code: https://a.example/me/it\n" in texts[1]
    assert "\nrepo_url: https://a.example/me/it\nsite_url: https://b.example/\n" in texts[2]
    assert "\n[![tests](https://a.example/me/it/actions/" in texts[3]
    assert '\nDOCUMENTATION = "https://b.example"\n' in texts[4]


def test_the_source_distribution_holds_documentation_and_tests(source: Path, tmp_path: Path) -> None:
    build = f"from setuptools import build_meta; build_meta.build_sdist({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=source, check=True, capture_output=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        files = {name.partition("/")[2] for name in opened.getnames()}
    wanted = {
        "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "Makefile", "mkdocs.yml", "requirements.lock",
        "docs/own-parts.md", "docs/environments/highway.md", "docs/img/films/highway.gif", "examples/tour.ipynb",
        "tests/test_packaging.py", "tests/sumo_env/env/test_driving.py", "agents/dqn.py", "experiments/sweep.py",
        "experiments/templates/report.html.j2", "networks/build.py", "sumo_env/env/driving.py",
        "networks/u_turn/u_turn.net.xml",
    }  # fmt: skip
    assert wanted - files == set()
    assert not any("__pycache__" in name for name in files)
