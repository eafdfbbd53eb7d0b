"""The paper's §8.4 table on this machine: one walk solved by IPOPT, by octo on one core, on all
cores, and on the GPU.

Run ``python examples/compare_ipopt_gpu.py``; ``--short`` solves one second instead of ten. What
this machine has not got is left out, and said.
"""

import os
import sys

import octo

SECONDS, DT = (1.0 if "--short" in sys.argv else 10.0), 0.025
CORES = len(os.sched_getaffinity(0))

robot = octo.gallery.mammal()
problem = octo.Problem(
    robot,
    steps=round(SECONDS / DT),
    dt=DT,
    basis="nodes",
    costs=[octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()],
)
# of octo's first pass: four feet sink by 0.08 ℓ, for all
stiffness = problem.weight / (4.0 * (0.08 * problem.length) ** 2)
law = {
    "contact.w_perp": stiffness,
    "contact.w_par": 10.0 * stiffness,
    "contact.onset": 0.04 * problem.length,
}
problem = problem.replace(parameters=law)
# and the same start: one iteration from octo's own
nodes = octo.solve(problem, max_iterations=1, device="cpu").x
options = octo.SqpOptions(max_iterations=1500)

runs = {"octo, one core": octo.solve(problem, start=nodes[1:], options=options, device="cpu")}
if CORES > 1:
    runs[f"octo, {CORES} cores"] = octo.solve(
        problem, start=nodes[1:], options=options, device="cpu", threads=CORES
    )
else:
    print("left out: octo on all cores, there is one")
gpu = octo.devices()["cuda"]
if not gpu.startswith("cannot be used"):
    # compiles
    octo.solve(problem, start=nodes[1:], options=octo.SqpOptions(max_iterations=2), device="cuda")
    runs["octo, GPU"] = octo.solve(problem, start=nodes[1:], options=options, device="cuda")
else:
    print(f"left out: octo on the GPU, which {gpu}")
runs["IPOPT"] = octo.reference.Ipopt(problem, options=options).solve(nodes, None, 0).solution

print(f"\n{problem.steps} steps of {DT} s, {robot.nx} degrees of freedom, nodes basis")
print(f"{'':20s}{'time':>10s}{'iterations':>12s}{'an iteration':>14s}{'E':>10s}{'‖C‖∞':>12s}  end")
for name, run in runs.items():
    each = 1e3 * run.seconds / max(1, run.iterations)
    numbers = (
        f"{run.seconds:8.2f} s{run.iterations:12d}{each:11.2f} "
        f"ms{run.energy:10.5f}{run.violation:10.1e} N"
    )
    print(f"{name:20s}{numbers}  {run.status.label}")
total = runs["IPOPT"].seconds
print(
    ", ".join(
        f"{name}: {total / run.seconds:.1f} times IPOPT's speed"
        for name, run in runs.items()
        if name != "IPOPT"
    )
)

assert all(run.converged for run in runs.values())
