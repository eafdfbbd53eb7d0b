"""The cache of compiled code: damaged files, folders that cannot serve, compilers that fail, dead
processes."""

from __future__ import annotations

import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import octo
from octo import cache, files, native
from octo.errors import DeviceError

ROOT = Path(octo.__file__).parents[1]
WHOLE = b"whole" * 1000
SEVEN = "int octo_seven(void) { return 7; }"
LOGGED = "import logging; logging.basicConfig(); "  # the library is silent of itself
USE = f"{LOGGED}from octo import native; print(native.load({SEVEN!r}).octo_seven())"
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, and no memory of earlier ones."""
    monkeypatch.setenv("OCTO_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "_given_up", set())
    cache._say.cache_clear()
    for path in cache.temporary().iterdir():
        cache.discard(path)
    return tmp_path / "cache"


@pytest.fixture
def makers() -> list[Path]:
    return []


def kept(made: list[Path], name: str = "code.so") -> Path:
    """What the cache has by that name; ``made`` counts how often it is made."""

    def make(path: Path) -> None:
        made.append(path)
        path.write_bytes(WHOLE)

    return cache.path_of(name, make)


def fresh(words: str, **environment: str | None) -> subprocess.CompletedProcess[str]:
    """Python's ``words`` in a process of their own."""
    values = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    return subprocess.run(
        [sys.executable, "-c", words],
        capture_output=True,
        text=True,
        env={k: v for k, v in values.items() if v is not None},
    )


def _directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _link(path: Path) -> None:
    other = path.with_name("other")
    path.rename(other)
    path.symlink_to(other)


DAMAGE: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: os.truncate(path, 2000),
    "empty": lambda path: os.truncate(path, 0),
    "zeroed": lambda path: path.write_bytes(bytes(len(WHOLE))),
    "one bit": lambda path: path.write_bytes(b"Whole" + WHOLE[5:]),
    "longer": lambda path: path.write_bytes(WHOLE + b"\0"),
    "another's": lambda path: path.write_bytes(b"foreign"),
    "missing": lambda path: path.unlink(),
    "a link": _link,
    "others may write": lambda path: path.chmod(0o666),
    "a folder": _directory,
    "without a digest": lambda path: cache.beside(path).unlink(),
    "an empty digest": lambda path: os.truncate(cache.beside(path), 0),
    "a digest of noise": lambda path: cache.beside(path).write_bytes(b"\xff\xfe\0"),
    "a digest that others may write": lambda path: cache.beside(path).chmod(0o622),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_what_is_damaged_is_made_anew_once(damage: str, folder: Path, makers: list[Path]) -> None:
    path = kept(makers)
    assert kept(makers) == path and len(makers) == 1
    DAMAGE[damage](path)
    again = kept(makers)
    assert len(makers) == 2 and again.read_bytes() == WHOLE and cache.whole(again)
    assert kept(makers) == again and len(makers) == 2
    assert [entry for entry in folder.iterdir() if entry.name.startswith(files.SCRATCH)] == []


@needs_compiler
def test_a_library_that_was_cut_is_compiled_anew(folder: Path) -> None:
    assert fresh(USE).stdout == "7\n"
    (library,) = folder.glob("*.so")
    os.truncate(library, 6000)
    done = fresh(USE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "7\n", "")
    shutil.copy("/proc/self/exe", library)  # a program, with a digest that fits
    cache.beside(library).write_text(__import__("hashlib").sha256(library.read_bytes()).hexdigest())
    assert fresh(USE).stdout == "7\n"


def test_files_and_folders_are_this_users_alone(folder: Path, makers: list[Path]) -> None:
    path = kept(makers)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert (
        stat.S_IMODE(path.stat().st_mode) == 0o700
        and stat.S_IMODE(cache.beside(path).stat().st_mode) == 0o600
    )


def test_a_folder_that_others_may_write_is_refused(
    folder: Path, makers: list[Path], caplog: pytest.LogCaptureFixture
) -> None:
    planted = kept(makers)
    folder.chmod(0o777)
    assert kept(makers) != planted and len(makers) == 2
    kept(makers, "other.so")
    (line,) = caplog.messages
    assert str(folder) in line and "other users may write there" in line


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("what", ["folder", "file", "digest"])
def test_what_belongs_to_another_user_is_refused(
    what: str, folder: Path, makers: list[Path]
) -> None:
    path = kept(makers)
    os.chown({"folder": folder, "file": path, "digest": cache.beside(path)}[what], 1234, -1)
    again = kept(makers)
    assert (
        len(makers) == 2
        and again.stat().st_uid == os.geteuid()
        and (again == path) == (what != "folder")
    )


def test_octos_own_folder_is_closed_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, makers: list[Path]
) -> None:
    monkeypatch.delenv("OCTO_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "octo").mkdir()
    (tmp_path / "octo").chmod(0o775)  # as versions before this one made it under many users' umask
    assert kept(makers).parent == tmp_path / "octo"
    assert stat.S_IMODE((tmp_path / "octo").stat().st_mode) == 0o700


@pytest.mark.parametrize("named", [".", "deep/er", "~/there"])
def test_names_of_the_folder(
    named: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, makers: list[Path]
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir(mode=0o755)
    monkeypatch.chdir(here)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("OCTO_CACHE", named)
    path = kept(makers)
    assert (
        path.is_absolute()
        and path.parent == {".": here, "deep/er": here / "deep/er", "~/there": there}[named]
    )
    assert kept(makers) == path and len(makers) == 1


@pytest.mark.parametrize("home", ["", "relative", "/proc/nobody"])
def test_without_a_home(
    home: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, makers: list[Path]
) -> None:
    for name in ("OCTO_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", home)
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.chdir(tmp_path)
    path, other = kept(makers), kept(makers, "other.so")
    assert (
        path.parent == other.parent == cache.temporary()
        and kept(makers) == path
        and len(makers) == 2
    )
    assert sorted(tmp_path.iterdir()) == []


def in_a_disk(options: str, words: str, cache_folder: Path) -> subprocess.CompletedProcess[str]:
    """As ``fresh``, where the cache is a disk of its own."""
    cache_folder.mkdir(mode=0o700)
    mounted = (
        f"mount -t tmpfs -o mode=700,{options} none {cache_folder} && exec {sys.executable} "
        f"-c '{words}'"
    )
    return subprocess.run(
        ["unshare", "-r", "-m", "sh", "-c", mounted],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OCTO_CACHE": str(cache_folder)},
    )


CAN_MOUNT = (
    shutil.which("unshare")
    and not subprocess.run(["unshare", "-r", "-m", "true"], capture_output=True).returncode
)
TWICE = (
    LOGGED
    + """
from octo import cache, native
a, b = native.load("int octo_a(void) { return 3; }"), native.load("int octo_b(void) { return 4; }")
print(a.octo_a() + b.octo_b(), len(list(cache.temporary().glob("*.so"))), cache.temporary())
""".replace("\n", ";")
    .strip(";")
    .replace("'", '"')
)


@needs_compiler
@pytest.mark.skipif(not CAN_MOUNT, reason="this user cannot mount a disk")
@pytest.mark.parametrize(
    ("options", "said"),
    [("ro", "Read-only"), ("noexec", "forbids running"), ("size=12k", "No space left")],
)
def test_a_disk_that_cannot_serve(options: str, said: str, tmp_path: Path) -> None:
    done = in_a_disk(options, TWICE, tmp_path / "disk")
    assert done.returncode == 0, done.stderr
    total, libraries, temporary = done.stdout.split()
    assert (total, libraries) == ("7", "2") and not Path(temporary).exists()
    assert (
        done.stderr.count("\n") == 1
        and said in done.stderr
        and str(tmp_path / "disk") in done.stderr
    )


def test_a_read_only_folder_still_serves_what_it_has(
    folder: Path, makers: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = kept(makers)

    def refuse(*words: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(cache, "_make", refuse)
    assert kept(makers) == path and len(makers) == 1
    with pytest.raises(DeviceError, match="Read-only file system"):
        kept(makers, "other.so")


COMPILERS = {  # CC, what it is, what is said
    "fails": ("false", "exit code 1"),
    "does nothing": ("true", "made no library"),
    "is no command line": ("gcc 'unclosed", "must be a compiler and its options"),
    "cannot be run": ("{folder}/garbage", "Exec format error"),
    "says noise": ("{folder}/noise", "exit code 3"),
    "kills itself": ("{folder}/killed", "ended by signal 9"),
    "makes a text": ("{folder}/text", "cannot be loaded"),
    "makes another library": ("{folder}/other", "not the library of octo's text"),
    "is for another machine": ("{folder}/old", "cannot be loaded"),
}
OUT = '[ "$1" = --version ] && exit; while [ "$1" != -o ]; do shift; done;'
SCRIPTS = {
    "noise": r"printf '\377\376\n\033[31m' >&2; exit 3",
    "killed": "kill -9 $$",
    "text": f'{OUT} echo hello > "$2"',
    "other": f'{OUT} echo "int x;" | gcc -shared -fPIC -xc -o "$2" -',
    "old": f'{OUT} printf "\\177ELF\\1\\1\\1" > "$2"',
}


@needs_compiler
@pytest.mark.parametrize("kind", COMPILERS)
def test_a_compiler_that_fails_is_one_line(
    kind: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, script in SCRIPTS.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)
    (tmp_path / "garbage").write_bytes(b"\0\1\2")
    (tmp_path / "garbage").chmod(0o755)
    words, said = COMPILERS[kind]
    monkeypatch.setenv("CC", words.format(folder=tmp_path))
    native.compiler.cache_clear()
    native.machine.cache_clear()
    try:
        with pytest.raises(DeviceError, match=said) as caught:
            native.load(SEVEN)
    finally:
        native.compiler.cache_clear()
        native.machine.cache_clear()
    assert "\n" not in str(caught.value)
    assert not folder.exists() or not list(folder.glob("*.so*"))


@needs_compiler
def test_a_compiler_that_is_not_there_is_said(folder: Path) -> None:
    done = fresh(USE, CC="/nowhere/gcc -O1")
    assert done.stdout == "7\n" and done.stderr.count("\n") == 1
    assert "CC is '/nowhere/gcc -O1', which is no program" in done.stderr


def test_what_dead_processes_left_is_removed(tmp_path: Path) -> None:
    sleep = "import time, sys; from octo import files; from pathlib import Path\n"
    sleep += (
        f"with files.scratch(Path({str(tmp_path)!r})) as f: print(f, flush=True); time.sleep(60)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = [
        subprocess.Popen(
            [sys.executable, "-c", sleep], stdout=subprocess.PIPE, text=True, env=environment
        )
        for _ in range(2)
    ]
    dead, alive = (Path(process.stdout.readline().strip()) for process in run if process.stdout)
    (dead / "half").write_text("a solution")
    mine = tmp_path / f"{files.SCRATCH}notes"  # a user's: not of eight letters
    mine.mkdir()
    run[0].send_signal(signal.SIGKILL)
    run[0].wait()
    with files.scratch(tmp_path) as folder:
        assert not dead.exists() and alive.exists() and mine.exists() and folder.exists()
    run[1].kill()
    run[1].wait()
    files.sweep(tmp_path, files.SCRATCH)
    assert sorted(tmp_path.iterdir()) == [mine]


def test_the_temporary_folder_outlives_a_fork_but_not_its_process() -> None:
    words = "import os; from octo import cache; f = cache.temporary(); print(f, flush=True)\n"
    words += (
        "child = os.fork()\nif child == 0: raise SystemExit\nos.waitpid(child, 0); assert "
        "f.exists()"
    )
    done = fresh(words)
    assert done.returncode == 0, done.stderr
    assert not Path(done.stdout.split()[0]).exists()


@needs_compiler
def test_two_threads_compile_once(folder: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    made: list[Path] = []

    def make(path: Path) -> None:
        made.append(path)
        time.sleep(0.05)
        path.write_bytes(WHOLE)

    with ThreadPoolExecutor(4) as pool:
        paths = set(pool.map(lambda _: cache.path_of("shared.so", make), range(4)))
    assert len(made) == len(paths) == 1


MAKES = """
import sys, time
from pathlib import Path
from octo import cache
def make(path):
    print("made", flush=True)
    time.sleep(1.0)
    path.write_bytes(b"whole")
cache.path_of("shared.so", make)
"""


def test_two_processes_compile_once(folder: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", MAKES]
    first = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert first.stdout is not None and first.stdout.readline() == "made\n"
    second = subprocess.run(command, capture_output=True, text=True, env=environment)
    first.communicate()
    assert (first.returncode, second.returncode, second.stdout) == (0, 0, "")
    assert {path.name for path in folder.iterdir()} == {"shared.so", "shared.so.sha256"}


def test_a_lock_that_is_not_released_is_waited_for_only_so_long(tmp_path: Path) -> None:
    with files.alone(tmp_path / "code.so", 60.0):
        began = time.monotonic()
        with files.alone(tmp_path / "code.so", 0.1):
            assert 0.1 <= time.monotonic() - began < 30.0
    assert list(tmp_path.iterdir()) == []
