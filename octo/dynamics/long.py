"""Long generated functions: how hard the compiler tries, what that costs, and how much is refused.

Measured with gcc 12 on user-written dynamics of 5 to 12 coordinates with contact points of a soft
body. A function of 22,000 instructions takes 11 s of processor time at -O3 and 5 s at -O1; one of
150,000 takes minutes and 5 GB at -O1, where time grows with the square. At -O0 589,000 lines take
18 s and 3.3 GB, in proportion; the code is 3.5 times slower than that of -O1.
Derivatives and their common subexpressions take 40 s for a million instructions, the text 12 s.
"""

from __future__ import annotations

import logging
from functools import cache

from octo.errors import ModelError

LOG = logging.getLogger("octo")
# instructions of a function from which the compiler's -O3 takes long and gains nothing …
LONG = 3000
HUGE = 50_000  # … and from which -O1 takes minutes
COSTLY = 200_000  # instructions of all functions from which the cost is said before
MOST = 2_000_000  # instructions that are compiled at all
SECONDS = 8e-5  # s of processor time for one of many instructions
BYTES = 5.5e3  # of memory for one


def brisk(text: str, instructions: int) -> str:
    """C text whose longest function is so long, at -O1 from LONG on, at -O0 from HUGE on."""
    if instructions < LONG:
        return text
    clang, level = ("", ""), "O1"
    if instructions >= HUGE:
        clang, level = ("#pragma clang optimize off", "#pragma clang optimize on"), "O0"
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
