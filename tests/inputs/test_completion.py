"""The shell: completion, help, the version, when the device is said; extras, metadata and
examples."""

from __future__ import annotations

import ast
import configparser
import importlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import octo
from octo.cli import completion
from octo.cli.main import main, parse, parser
from octo.errors import MissingExtraError

ROOT = Path(__file__).parents[2]
DRIVER = """
source /dev/stdin
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _octo; printf '%s\\n' "${COMPREPLY[@]}"
"""
COMPLETED = {
    "octo so": ["solve"],
    "octo solve ma": ["mammal"],
    "octo solve mammal --go": ["--goal"],
    "octo solve mammal --goal st": ["stride", "stand"],
    "octo solve mammal --goal = tu": ["turn"],
    "octo mpc mammal --goal ju": [],
    "octo cycle mammal --device cu": ["cuda"],
    "octo solve mammal --world sta": ["stairs"],
    "octo help vi": ["view"],
    "octo completion f": ["fish"],
    "octo --ver": ["--version"],
    "octo view --o": ["--out"],
    "octo export --f": ["--fps"],
}


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize("words", COMPLETED)
def test_bash_completes(words: str, tmp_path: Path) -> None:
    script = completion.script("bash", parser()[1])
    done = subprocess.run(
        ["bash", "-c", DRIVER, "bash", *words.split()],
        input=script,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.stderr == "" and done.stdout.split() == COMPLETED[words]


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_files(tmp_path: Path) -> None:
    (tmp_path / "go2.urdf").touch()
    script = completion.script("bash", parser()[1])
    done = subprocess.run(
        ["bash", "-c", DRIVER, "bash", "octo", "solve", "go"],
        input=script,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.stdout.split() == ["go2.urdf"]


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_every_option_is_in_every_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    for name, made in parser()[1].items():
        assert name in text
        for option in made._option_string_actions:
            assert not option.startswith("--") or option.removeprefix("--") in text


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_read_their_script(shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    done = subprocess.run(
        [shell, "-n"], input=completion.script(shell, parser()[1]), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_words_that_are_completed_are_accepted() -> None:
    """Every option that has words belongs to a command; a goal or a device that octo has not got is
    not offered."""
    options = {option for made in parser()[1].values() for option in made._option_string_actions}
    assert set(completion.WORDS) <= options
    for key in completion.OTHERS:
        command, option = key.split()
        assert option in parser()[1][command]._option_string_actions


# -- help and version -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words", [["help"], ["help", "solve"], ["help", "help"], ["help", "completion"]]
)
def test_help(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 0
    shown = capsys.readouterr().out
    with pytest.raises(SystemExit) as stopped:
        main([*words[1:], "--help"])
    assert stopped.value.code == 0 and capsys.readouterr().out == shown


@pytest.mark.parametrize("word", ["-V", "--version"])
def test_version(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([word])
    assert stopped.value.code == 0 and capsys.readouterr().out == f"octo {octo.__version__}\n"


REFUSED = {
    "help viw": "did you mean view",
    "completion tcsh": "bash",
    "--versoin": "--version",
    "completion": "SHELL",
}


@pytest.mark.parametrize("words", REFUSED)
def test_refused(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 2
    assert REFUSED[words] in capsys.readouterr().err


# -- when the device is said ----------------------------------------------------------------------

SOLVE = [
    "solve",
    "chain",
    "--costs",
    "paper",
    "--seconds",
    "0.1",
    "--passes",
    "1",
    "--max-iterations",
    "1",
]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], False),
        (["--device", "cpu"], False),
        (["--device", "auto"], True),
        (["--verbose"], True),
    ],
    ids=["nothing", "cpu", "auto", "verbose"],
)
def test_the_line_about_the_gpu(
    more: list[str],
    said: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import octo.solve  # noqa: F401

    front = sys.modules["octo.devices"]
    monkeypatch.setattr(front.cuda, "reason", lambda: "there is none")  # type: ignore[attr-defined]
    front.say_cpu.cache_clear()  # type: ignore[attr-defined]
    assert main([*SOLVE, "--out", str(tmp_path / "out"), *more]) == 1
    printed = capsys.readouterr()
    assert ("octo: using the CPU: there is none" in printed.err) == said
    assert "on cpu" in printed.out
    assert '"device": "cpu"' in (tmp_path / "out" / "report.json").read_text()


@pytest.mark.parametrize(
    ("command", "device"),
    [("solve", "auto"), ("cycle", "auto"), ("compare", "cpu"), ("mpc", "cpu")],
)
def test_devices_by_default(command: str, device: str) -> None:
    plain, asked = parse([command, "chain"]), parse([command, "chain", "--device", "cuda"])
    assert (plain.device, plain.verbose) == (device, False)
    assert (asked.device, asked.verbose) == ("cuda", True)


# -- extras, metadata, examples --------------------------------------------------------------------


def setup_cfg() -> configparser.ConfigParser:
    read = configparser.ConfigParser()
    read.read(ROOT / "setup.cfg")
    return read


def test_extras_go_by_one_name_everywhere() -> None:
    extras = set(setup_cfg()["options.extras_require"])
    kinds = "robots view export mesh soft mesher graph cluster cuda12 cuda13 dev docs"
    assert extras == set(kinds.split())
    named: set[str] = set()
    for path in [
        ROOT / "README.md",
        ROOT / "Makefile",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "octo").rglob("*.py"),
    ]:
        text = path.read_text(encoding="utf-8")
        for group in re.findall(r"(?:octo-trajopt|\.)\[([a-z0-9,]+)\]'", text):
            named.update(group.split(","))
        named.update(re.findall(r"""MissingExtraError\([^)]*, ["'](\w+)["']\)""", text))
    assert named and named <= extras
    assert "'octo-trajopt[view]'" in str(MissingExtraError("a plot", "view"))


def test_metadata() -> None:
    values = setup_cfg()["metadata"]
    assert (
        values["author"] and values["license"] == "BSD-3-Clause" and "Linux" in values["platforms"]
    )
    for words in ("Operating System :: POSIX :: Linux", "Python :: 3.11", "Typing :: Typed"):
        assert words in values["classifiers"]


def public(module: str, name: str) -> bool:
    """Whether ``from module import name`` is of names that octo shows to users."""
    if module == "octo":
        return name in octo.__all__
    known = getattr(importlib.import_module(module), "__all__", ())
    return module.count(".") == 1 and module.partition(".")[2] in octo.__all__ and name in known


@pytest.mark.parametrize(
    "path", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem
)
def test_examples_import_public_names_only(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "octo":
            assert all(public(node.module, alias.name) for alias in node.names), ast.unparse(node)
        if isinstance(node, ast.Import):
            assert all(
                alias.name == "octo" or not alias.name.startswith("octo.") for alias in node.names
            ), ast.unparse(node)
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Name)
            and node.value.id == "octo"
        ):
            assert node.attr in octo.__all__, ast.unparse(node)
