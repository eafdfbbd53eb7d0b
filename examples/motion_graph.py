"""A motion graph: motions, all transitions between them, and a path that does what it is told.

Four motions of 10 s of a mammal and 300 pairs of their moments, in about two minutes on two cores.
"""

import tempfile
from pathlib import Path

import numpy as np

import octo

SCRIPT = [("walk", 2.0), ("jump", 1.0), ("walk", 2.0), ("left", 2.0), ("right", 2.0)]


def main(folder: str) -> None:
    graph = octo.motion_graph.build(
        octo.gallery.mammal(),
        ["walk", "left", "right", "jump"],
        path=Path(folder) / "mammal.graph",
        seconds=10.0,
        every=8,  # every two seconds
        progress=True,
        device="cpu",
    )
    print(graph)
    found = graph.report()
    assert found["pairs"] == 300 and found["transitions"] >= 0.8 * found["pairs"]

    route = graph.route(SCRIPT)
    print(route)
    motion = route.motion  # torques and forces are measured anew, at the joints of edges too
    print(motion)
    assert motion.pointwise_residual <= 1e-5 and motion.torque_excess <= 1.0 + 1e-6
    assert np.mean([switch.wait for switch in route.switches]) <= 2.0


if __name__ == "__main__":  # new processes read this file too
    with tempfile.TemporaryDirectory() as made:
        main(made)
