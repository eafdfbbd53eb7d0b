"""From octo's docstrings to the site's reference: who is public, and what each parameter means.

A docstring says ``name: text`` a line under ``Parameters``, ``Attributes`` or ``Raises``; a field
of a dataclass may say it in the comment behind it, and what a class inherits is said by its base.
"""

from __future__ import annotations

import ast
import enum
import inspect
import re
import textwrap
from collections.abc import Collection, Iterator
from typing import Any

import octo

SECTION = re.compile(r"^(Parameters|Attributes|Raises|Returns)\n-{3,}\n", re.MULTILINE)
NAME = r"\*{0,2}[A-Za-z]\w*(?: \([^()]*\))?"  # with its shape: u (N, nu)
NAMES = f"{NAME}(?:, {NAME})*"
ENTRY = re.compile(f"({NAMES}): ?(.*)")
RUN_IN = re.compile(rf"(?<=[.;)]) (?={NAMES}: )")
# A literal, a role or a link stays as it is; elsewhere the signs of reStructuredText are text.
KEPT = re.compile(r"(``.*?``|:[\w:]+:`.*?`)", re.DOTALL)
# What means the same wherever it stands, and is said once.
WORDS = {
    "robot": "a Character: what ``octo.load`` or ``octo.gallery`` gives.",
    "character": "a Character: what ``octo.load`` or ``octo.gallery`` gives.",
    "problem": "an ``octo.Problem``.",
    "solution": "an ``octo.Solution``, or the path of a saved one where a file is read.",
    "body": "name of a body; the base by default.",
    "x": "(..., nx) rad and m.",
    "q": "(nq,) the configuration in MuJoCo's form.",
    "v": "(nv,) the velocity in MuJoCo's form.",
    "values": "run-time numbers by name, (size,) or (N, size).",
    "fixed_scale": "the number that the term of E is divided by.",
    "path": "where it is written.",
    "terrain": "the ground, an ``octo.Plane``, ``Terrain`` or ``World``; level by default.",
    "law": "the contact law, one of ``octo.laws``; Eq. 6 by default.",
    "pose": "(nx,) rad and m: where a static start is searched from.",
    "start": "what to start from instead of the static pose, as of ``octo.solve``.",
    "seed": "the number of the first start, or of the noise: the same number, the same result.",
    "passes": "how many passes of growing contact stiffness.",
    "options": "an ``octo.SqpOptions``.",
    "max_iterations": "at most so many iterations in a pass.",
    "time_limit": "s, of everything together; the best iterate so far is returned.",
    "tolerance": "‖C‖∞ relative to the weight.",
    "device": '"cpu", "cuda" or "auto".',
    "threads": "of the CPU's native code.",
    "progress": "print a line now and then, behind this text if it is one.",
    "callback": "called after every iteration; returning True stops.",
}


def public() -> Iterator[tuple[str, Any]]:
    """Every public name, ``octo.x`` or ``octo.module.x``, with its object."""
    for name in octo.__all__:
        value = getattr(octo, name)
        if not inspect.ismodule(value):
            yield f"octo.{name}", value
            continue
        for inner in getattr(value, "__all__", sorted(vars(value))):
            member = vars(value)[inner]
            own = hasattr(value, "__all__") or getattr(member, "__module__", "") == value.__name__
            # octo.errors: its functions shorten what a message holds, for octo itself
            if own and not inner.startswith("_") and (name != "errors" or inspect.isclass(member)):
                yield f"octo.{name}.{inner}", member


def sections(doc: str) -> list[tuple[str, str]]:
    """The parts of a docstring: ("", prose) and (title, text), in their order."""
    pieces = SECTION.split(doc)
    return [("", pieces[0]), *zip(pieces[1::2], pieces[2::2], strict=True)]


def entries(text: str, known: Collection[str] = ()) -> dict[str, str]:
    """``name: text`` by name, with deeper lines that go on.

    Several names may share a text, ``a, b (N,): text``. One of ``known``, or an error, begins an
    entry also behind the end of a sentence.
    """
    found: dict[str, str] = {}
    for block in re.split(r"\n(?=\S)", text.strip("\n")):
        heads: dict[str, str] = {}
        for k, piece in enumerate(RUN_IN.split(" ".join(block.split()))):
            match = ENTRY.match(piece)
            named = dict(re.findall(r"([A-Za-z]\w*)(?: (\([^()]*\)))?", match[1])) if match else {}
            if match and (k == 0 or all(n in known or n.endswith("Error") for n in named)):
                heads = named
                found |= {name: f"{shape} {match[2]}".strip() for name, shape in named.items()}
            else:
                found |= {name: f"{found[name]} {piece}" for name in heads}
    return found


def comments(kind: type) -> dict[str, str]:
    """What the comment behind each field of a class says, and the ones in the lines above it."""
    try:
        lines = textwrap.dedent(inspect.getsource(kind)).splitlines()
    except (OSError, TypeError):
        return {}
    found = {}
    for node in ast.parse("\n".join(lines)).body[0].body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            last = (node.end_lineno or node.lineno) - 1
            behind = lines[last].encode()[node.end_col_offset :].decode().partition("#")[2]
            above, k = [], node.lineno - 2
            while k >= 0 and lines[k].strip().startswith("#"):
                above.insert(0, lines[k].strip().lstrip("# "))
                k -= 1
            said = " ".join([*above, behind.strip()]).strip()
            if said:
                found[node.target.id] = said
    return found


def described(value: Any) -> dict[str, str]:
    """The text of each parameter of a function or a class, inherited ones first."""
    known = parameters(value)
    found: dict[str, str] = {}
    for kind in reversed(value.__mro__[:-1]) if inspect.isclass(value) else [value]:
        if inspect.isclass(kind):
            found |= comments(kind)
        doc = kind.__dict__.get("__doc__") if inspect.isclass(kind) else kind.__doc__
        for title, text in sections(inspect.cleandoc(doc or "")):
            if title in ("Parameters", "Attributes"):
                found |= entries(text, known)
    return {name: WORDS[name] for name in known if name in WORDS} | found


def parameters(value: Any) -> list[str]:
    """The names of a signature; of a class those of its constructor."""
    if not callable(value):
        return []
    if inspect.isclass(value) and issubclass(value, (enum.Enum, BaseException)):
        return []
    if getattr(value, "_is_protocol", False):
        return []
    return [
        name
        for name, one in inspect.signature(value).parameters.items()
        if name not in ("self", "args")
        and not name.startswith("_")
        and one.kind is not one.VAR_KEYWORD
    ]


def undocumented(value: Any) -> list[str]:
    """The parameters of which neither a line, a comment nor the prose (````name````) says
    anything."""
    told = described(value)
    docs = [value, *(value.__mro__[1:-1] if inspect.isclass(value) else ())]
    prose = "\n".join(inspect.cleandoc(one.__doc__ or "") for one in docs)
    return [
        name
        for name in parameters(value)
        if name not in told and not re.search(rf"``{name}\b", prose)
    ]


def escaped(text: str) -> str:
    """Text in which |x|, a*b and x_ are themselves."""
    parts = KEPT.split(text)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"([|*`]|_(?=\W|$))", r"\\\1", parts[k])
    return re.sub(r"^(\w\.)", r"\\ \1", "".join(parts))  # "s." begins no list


def rendered(doc: str, value: Any = None) -> list[str]:
    """A docstring as lines of reStructuredText, one parameter a line; ``value``: a class or a
    function, of which also the inherited fields and the comments behind them are listed."""
    known = parameters(value) if value is not None else []
    told = {} if value is None else dict(described(value))
    told = {name: said for name, said in told.items() if name in known}
    lines: list[str] = []
    for title, text in sections(doc):
        if not title:
            lines += [*escaped(text).rstrip().splitlines(), ""]
        elif title in ("Parameters", "Attributes"):
            told = entries(text, known) | told
        elif title == "Returns":
            lines.append(f":returns: {escaped(' '.join(text.split()))}")
        else:
            lines += [f":raises {name}: {escaped(said)}" for name, said in entries(text).items()]
    first = [name for name in known if name in told]
    rows = [f":param {name}: {escaped(told[name])}" for name in first]
    rows += [f":ivar {name}: {escaped(told[name])}" for name in told if name not in known]
    end = next((k for k, line in enumerate(lines) if line.startswith(":")), len(lines))
    return [*lines[:end], *rows, *lines[end:], ""]
