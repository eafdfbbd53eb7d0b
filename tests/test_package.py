"""The names of octo, how it is imported, and the wheel."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import octo

ROOT = Path(__file__).parents[1]
TINY = """
import octo
problem = octo.Problem(octo.gallery.chain(), steps=3, dt=0.02, costs=[octo.Effort()])
solution = octo.solve(problem, passes=1, max_iterations=3)
print(octo.__file__, solution.x.shape)
"""


def run(code: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", octo.__all__)
def test_every_name_is_there(name: str) -> None:
    assert getattr(octo, name) is not None


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'sovle'"):
        octo.sovle  # noqa: B018


FIRST = [
    "import octo.solve",
    "from octo.solve import solve",
    "octo.solve",
    "import octo.plot, octo.solve",
]


@pytest.mark.parametrize("first", FIRST)
def test_solve_and_plot_are_functions(first: str) -> None:
    """Whatever was imported first: the modules have the same names."""
    used = (
        "assert callable(octo.solve) and callable(octo.plot)\nfrom octo.solve import "
        "solve\nassert solve is octo.solve"
    )
    run(f"import octo\n{first}\n{used}")


def test_import_is_quick_and_needs_no_extra() -> None:
    extras = ("mujoco", "matplotlib", "viser", "cupy", "nvidia", "skfem", "meshio", "tetgen")
    loaded = run("import sys, octo, octo.cli.main; print(*sys.modules)").split()
    assert not set(extras) & {name.partition(".")[0] for name in loaded}
    light = run("import sys, octo; print(*sys.modules)").split()
    assert "casadi" not in light and "numpy" not in light


def data_files(folder: Path) -> set[str]:
    found = (
        path for path in (folder / "octo").rglob("*") if path.suffix in (".c", ".cu", ".typed")
    )
    return {path.relative_to(folder).as_posix() for path in found}


def test_a_wheel_installed_elsewhere_solves_and_measures(
    tmp_path: Path, plain_environment: dict[str, str]
) -> None:
    """The C and CUDA texts and py.typed come along."""
    source, target = tmp_path / "source", tmp_path / "target"
    shutil.copytree(ROOT / "octo", source / "octo", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("setup.cfg", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run(
        [
            *pip,
            "wheel",
            "--use-pep517",
            "--no-deps",
            "--no-build-isolation",
            "-w",
            tmp_path,
            source,
        ],
        check=True,
        cwd=tmp_path,
    )
    (wheel,) = tmp_path.glob("octo_trajopt-*.whl")
    subprocess.run(
        [*pip, "install", "--no-deps", "--target", target, wheel], check=True, cwd=tmp_path
    )
    installed, written = data_files(target), data_files(ROOT)
    assert installed == written and "octo/py.typed" in installed
    own = {**plain_environment, "PYTHONPATH": str(target), "OCTO_CACHE": str(tmp_path / "cache")}
    printed = run(f"import os; os.chdir({str(tmp_path)!r}){TINY}", **own)
    assert str(target) in printed and "(5, 14)" in printed
    bench = (
        "from octo.cli.main import main; assert main(['bench', '--quick', '--only', "
        "'dynamics']) == 0"
    )
    printed = run(f"import os; os.chdir({str(tmp_path)!r})\n{bench}", **own)
    # the committed one is a clone's
    assert "dynamics.mammal.fd_jacobian" in printed and "baseline" not in printed


@pytest.mark.parametrize(
    "page",
    sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")], key=str),
    ids=lambda page: page.name,
)
def test_names_and_links_of_the_pages_exist(page: Path) -> None:
    text = page.read_text()
    for name in re.findall(r"\bocto\.((?:[A-Za-z]\w*)(?:\.[A-Za-z]\w*)?)\(", text):
        value: object = octo
        for part in name.split("."):
            value = getattr(value, part)
        assert callable(value), name
    for link in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (page.parent / link).exists(), link
