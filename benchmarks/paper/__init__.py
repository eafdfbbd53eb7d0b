"""Every figure and table of section 8 of the paper, measured on this machine.

    python -m benchmarks.paper [--only fig7,fig8] [--short] [--again] [--out DIR]

A figure is a module with ``TITLE``, ``PANELS``, ``measure(short) -> dict`` that JSON can hold,
``draw(records, axes)`` on so many axes, and ``rows(records)`` of the table that docs/paper.md has
of it. The records go into benchmarks/results/paper.json, the pictures and tables into docs; with
``--out`` or ``--short`` all of it goes into one folder. A figure that is done is not measured
again unless ``--again`` asks for it.
"""
