"""What of the paper's figures octo cannot make yet."""

from __future__ import annotations

from benchmarks.paper.page import Row

NOT_YET = "not there yet"
ROWS = {
    "fig2": [
        Row(
            "a ball and a beam that jump (Fig. 2)",
            "|x| = 16 for both, reduced-order deformable bodies",
            NOT_YET,
            "octo's bodies are rigid",
        )
    ]
}
