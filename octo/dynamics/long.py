"""Long generated functions: how hard the compiler tries, what that costs, and how much is refused.

Measured with gcc 12 on user-written dynamics with contact points of a soft body, and on the exact
second derivatives of a humanoid under hard limits. The compiler's time grows with the square of a
function's length, from some thousand instructions on (-O1: 5 s for 17,000, minutes and 5 GB for
150,000), and its stack holds every value. In sections (octo.emit) it is in proportion, 0.1 ms an
instruction; two thirds of 17,000 are saved. At -O0 95,000 lines took 6 s and now take 12, and the
code was three times slower; the stack of 560,000 ended the process.
Derivatives and their common subexpressions take 40 s for a million instructions, the text 12 s.
"""

from __future__ import annotations

import logging
from functools import cache

from octo.errors import ModelError

LOG = logging.getLogger("octo")
# instructions of a function from which the compiler's -O3 takes long and gains nothing …
LONG = 3000
HUGE = 50_000  # … and from which -O1 takes minutes, of one that is not in sections
SECTION = 500  # instructions of a section: with 250 compiling is slower, with 2,000 the code
COSTLY = 200_000  # instructions of all functions from which the cost is said before
MOST = 2_000_000  # instructions that are compiled at all
SECONDS = 1.6e-4  # s of processor time for one of many instructions
BYTES = 2.4e3  # of memory for one


def brisk(text: str, instructions: int) -> str:
    """C text whose longest function is so long, at -O1 from LONG on, at -O0 from HUGE on."""
    if instructions < LONG:
        return text
    return optimised(text, "O0" if instructions >= HUGE else "O1")


def optimised(text: str, level: str) -> str:
    """C text that is compiled at ``level``, O0 or O1, where the rest of it is optimised."""
    off = ("#pragma clang optimize off", "#pragma clang optimize on")
    clang = off if level == "O0" else ("", "")
    gcc = (f'#pragma GCC push_options\n#pragma GCC optimize ("{level}")', "#pragma GCC pop_options")
    text_of = "#ifdef __clang__\n{}\n#elif defined(__OPTIMIZE__)\n{}\n#endif".format
    begin, end = map(text_of, clang, gcc)
    return "\n".join([begin, text, end, ""])


def check_length(what: str, instructions: int, hint: str) -> None:
    """Say what many instructions will cost, or refuse them. ``hint``: what to do instead.

    Raises
    ------
    ModelError: there are more than MOST.
    """
    if instructions > MOST:
        raise ModelError(
            f"{what}: {in_words(instructions)} instructions of C with their derivatives, at most "
            f"{in_words(MOST)} are compiled: {hint}"
        )
    if instructions >= COSTLY:
        _say(what, instructions)


@cache
def _say(what: str, instructions: int) -> None:
    seconds, memory = f"{SECONDS * instructions:.0f} s", f"{BYTES * instructions / 1e9:.1f} GB"
    LOG.warning(
        f"{what}: {in_words(instructions)} instructions of C with their derivatives; to generate "
        f"and compile them takes about {seconds} of processor time and {memory} of memory, the "
        "first time"
    )


def in_words(instructions: int) -> str:
    if instructions < 1_000_000:
        return f"{instructions / 1e3:.0f} thousand"
    return f"{instructions / 1e6:.3g} million"
