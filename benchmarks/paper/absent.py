"""What of the paper's figures octo cannot make yet, or has not measured."""

from __future__ import annotations

from benchmarks.paper.page import NOT_RUN, Row

NOT_YET = "not there yet"
ROWS = {
    "fig11": [
        Row(
            "gaits, convergence, stability (Fig. 11)",
            "510 s; “generates realistic walking gaits”, “long-term stability” with Eq. 16",
            NOT_RUN,
            "",
        )
    ],
    "fig2": [
        Row(
            "a ball and a beam that jump (Fig. 2)",
            "|x| = 16 for both, reduced-order deformable bodies",
            NOT_YET,
            "octo's bodies are rigid",
        )
    ],
    "sec86": [
        Row(
            "motion graphs of a spider and a mammal (Fig. 12)",
            "“within 60min of computation for each characters”",
            NOT_YET,
            "",
        )
    ],
}
