"""Crocoddyl's own trotting problem of anymal_b, carried on for nine seconds: prints one line of
JSON.

    PYTHON benchmarks/crocoddyl_trot.py STEP_LENGTH

Run by benchmarks.cycles with a Python that has crocoddyl 3.2.1 (pip install pin==4.0.0
libpinocchio==4.0.0 crocoddyl==3.2.1). Models, terms, start, height of steps and solver are those of
its example quadrupedal_gaits_fwddyn; the time step is octo's (25 ms, 10 there), and strides follow
one another as the steps of createTrottingProblem do. Which foot is on the ground when, where it
goes and how high it swings are given; the example's step is 0.15 m long.
"""

import json
import sys
import time

import crocoddyl
import example_robot_data
import numpy as np
import pinocchio
from crocoddyl.utils.quadruped import SimpleQuadrupedalGaitProblem

TIME_STEP = 0.025  # s
SWING, SUPPORT = 13, 2  # nodes on two and on four feet: a stride of 0.75 s
STRIDES = 12
STEP_HEIGHT = 0.1  # m
ITERATIONS = 100


def trot(
    gait: SimpleQuadrupedalGaitProblem, x0: np.ndarray, step: float
) -> crocoddyl.ShootingProblem:
    """Strides of createTrottingProblem in a row."""
    pinocchio.forwardKinematics(gait.rmodel, gait.rdata, x0[: gait.rmodel.nq])
    pinocchio.updateFramePlacements(gait.rmodel, gait.rdata)
    feet = [gait.lfFootId, gait.rfFootId, gait.lhFootId, gait.rhFootId]
    lf, rf, lh, rh = (gait.rdata.oMf[foot].translation.copy() for foot in feet)
    com = (lf + rf + lh + rh) / 4
    com[2] = pinocchio.centerOfMass(gait.rmodel, gait.rdata, x0[: gait.rmodel.nq])[2].item()
    one, other = [gait.lfFootId, gait.rhFootId], [gait.rfFootId, gait.lhFootId]
    models = []
    for stride in range(STRIDES):
        first = 0.5 if stride == 0 else 1.0
        for length, places, stance, swing in (
            (first * step, [rf, lh], one, other),
            (step, [lf, rh], other, one),
        ):
            models += [gait.createSwingFootModel(TIME_STEP, feet) for _ in range(SUPPORT)]
            models += gait.createFootstepModels(
                com, places, length, STEP_HEIGHT, TIME_STEP, SWING, stance, swing
            )
    return crocoddyl.ShootingProblem(x0, models, gait.createSwingFootModel(TIME_STEP, feet))


def main() -> None:
    robot = example_robot_data.load("anymal")
    x0 = np.concatenate([robot.model.referenceConfigurations["standing"], np.zeros(robot.model.nv)])
    gait = SimpleQuadrupedalGaitProblem(robot.model, "LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT")
    problem = trot(gait, x0, float(sys.argv[1]))
    problem.nthreads = 1
    solver = crocoddyl.SolverFDDP(problem)
    began = time.process_time()
    start = [x0] * (problem.T + 1)
    converged = solver.solve(start, problem.quasiStatic([x0] * problem.T), ITERATIONS, False)
    record = {
        "processor": time.process_time() - began,
        "converged": bool(converged),
        "iterations": solver.iter + 1,
        "nodes": problem.T,
        "seconds": TIME_STEP * 2 * (SWING + SUPPORT) * STRIDES,
        "way": float(solver.xs[-1][0] - x0[0]),
        "cost": float(solver.cost),
    }
    print(json.dumps(record))


if __name__ == "__main__":
    main()
