"""The compiled text of one model and one list of terms, and the sizes that launches need."""

from __future__ import annotations

import functools

import numpy as np

from octo.dynamics.codegen import macros
from octo.dynamics.evaluate import Dynamics
from octo.errors import DeviceError
from octo.gpu.between import Between
from octo.gpu.curvature import Bends
from octo.gpu.device import WIDE, Device, Kernel, Kernels, source
from octo.gpu.pieces import Pieces
from octo.gpu.step_pairs import StepPairs
from octo.problem import codegen
from octo.problem.codegen import CostFunctions
from octo.problem.compiled import CompiledProblem
from octo.problem.contact_model import TOUCHED
from octo.problem.row_products import RowSlopes

WARP = 32  # threads of a block, for a node
# for the derivatives of a step: of 255 registers, four blocks fit a multiprocessor, 400 steps are
# one wave
NARROW = 64
SMALL = 128  # for a step
# for the products of a step's rows: a thread for each pair of tiles of 18 degrees of freedom
TILED = 192
PARTS = 128  # of common.cuh
# columns that a thread multiplies with as many; steps that a block evaluates the costs of
TILE, TOGETHER = 3, 2
# for the kernels
DEFINED = {"WARP": WARP, "SMALL": SMALL, "TILED": TILED, "FLAT": WIDE}
DEFINED |= {"TILE": TILE, "TOGETHER": TOGETHER}
BARRIER = 40  # numbers of each bounded row that an interior point has at the same time
HELD = 48 * 1024  # bytes of a step's rows at the same time: four blocks fit a multiprocessor
# of dynamics.cu
DYNAMICS = (
    *("octo_work_size", "octo_kin_of_nodes", "octo_looks"),
    *("octo_value", "octo_jacobian", "octo_curvature"),
)


class Program(Kernels):
    """The compiled text of one model and one list of terms, and the sizes that launches need."""

    def __init__(self, problem: CompiledProblem, device: Device):
        dynamics, functions = problem.dynamics, problem.functions
        self.texts, pieces, self.kept = _texts(functions, dynamics)
        device.compile(self.texts)
        self._dynamics = device.module(self.texts[0])
        super().__init__(device, self.texts[1])
        between = problem.program.between
        self.between = None if between is None else Between(between, device)
        bent = functions.curvature is not None
        self.bends = Bends(functions, dynamics, device) if bent else None
        pairs = functions.pairs
        self.pairs = None if pairs is None else StepPairs(problem, pairs, device)
        size = device.empty((2,), np.int32)
        self.kernel("octo_work_size")((1,), 1, size)
        self.work, self.kin = (int(value) for value in device.host(size))  # doubles
        self.rows = functions.rows
        # doubles that the costs of a step share
        self.arguments = dynamics.nu + 2 * len(pieces.angles) + functions.calls.size
        self.entries = functions.state_sparsity.nnz()
        self.touch = len(functions.contact_spheres) * contact_numbers(functions)
        held = TOUCHED + 54 * dynamics.nx  # bytes are for contacts that have terms
        contact = functions.contact
        self.touching = 0 if contact is None else 8 * (18 * contact.factors.size + held)
        self.terms = len(functions.references.terms)
        self.curvature = dynamics.curvature_blocks
        width, rows = 3 * dynamics.nx, len(functions.state_terms)
        self.held = max(1, min(rows, HELD // (8 * width)))
        self.room = 8 * (2 * rows + self.held * width + TILE)
        if 8 * self.work > device.shared_limit:
            raise DeviceError(
                f"a step needs {8 * self.work} bytes of shared memory, this device has "
                f"{device.shared_limit}: the robot is too large for it; try device 'cpu'"
            )

    def kernel(self, name: str) -> Kernel:
        return self._dynamics.kernel(name) if name in DYNAMICS else super().kernel(name)


@functools.lru_cache(maxsize=8)
def _texts(
    functions: CostFunctions, dynamics: Dynamics
) -> tuple[tuple[str, str], Pieces, RowSlopes | None]:
    """Two texts, for they are compiled side by side; the pieces of the costs, and what a
    linearisation keeps of the slopes of bounded rows, that they are made of."""
    text = dynamics.text()
    if not text:
        raise DeviceError("this user-written dynamics has no C text: it runs on the CPU only")
    text = codegen.asked_of_world(functions, dynamics) + text
    pieces, stages = Pieces.of(functions), functions.calls.stages_text
    own = (pieces.functions, pieces.rows, pieces.columns)
    costs = [codegen.residual_text(functions, dynamics, *own), pieces.text()]
    defined = [macros(DEFINED)]
    if functions.pairs is not None:
        defined.append("#define FOUR_PARTS")  # of the units of a cycle
    common = [*defined, source("common.cuh")]
    model = [*common, source("model.cu"), source("gather.cu")]
    kept = codegen.kept_slopes(functions, dynamics, (pieces.rows, pieces.columns))
    if kept is not None:
        model += [kept.tables(), kept.turned_tables(), source("row_products.cu")]
    steps = [text, *common, source("dynamics.cu")]
    if dynamics.looks:
        steps.append(source("looks.cu"))
    return ("\n".join(steps), "\n".join([stages + text, *costs, *model])), pieces, kept


def contact_numbers(functions: CostFunctions) -> int:
    """TOUCHED of model.cu."""
    size = 0 if functions.contact is None else functions.contact.factors.size
    return 19 * size + size * (size + 1) // 2 + TOUCHED - 18


def bytes_of(problem: CompiledProblem) -> int:
    """Device memory of one problem of a batch: two models, two factors and what makes them, eight
    iterates, the scratch."""
    n, N, K, nc, ma = problem.n, problem.steps, problem.K, problem.nc, problem.ma
    functions, blocks = problem.functions, -(-problem.K // 2)
    rows, touch = functions.rows, len(functions.contact_spheres) * contact_numbers(functions)
    values = len(functions.references.terms) + len(functions.bounded)
    iterate = K * (nc + ma) + N * (2 * n + values) + K * ma
    model = K * (3 * nc * nc + 3 * ma * nc + nc)
    squares = 3 + problem.dynamics.curvature_blocks + 6  # of n numbers a step: jac, curvature, hess
    scratch = N * (rows + functions.state_sparsity.nnz() + touch + 5 * n + n * n * squares)
    if functions.curvature is not None:
        scratch += N * len(functions.curvature.rows)
    if problem.program.kept is not None:
        model += N * problem.program.kept.size
        scratch += N * (3 * n + BARRIER * len(functions.bounded))
    if problem.program.between is not None:
        scratch += K * problem.program.between.rows * (2 * nc + 1)
    if functions.pairs is not None:
        scratch += N * (functions.pairs.rows * (4 * n + 2) + functions.pairs.sparsity.nnz())
    # poses and twists: bodies are no more than a few for each degree of freedom
    kin = N * 12 * (3 * n)
    factor = sum(blocks * B * B * 7 for B in (2 * (nc + ma), 2 * ma))
    return 8 * (8 * iterate + 2 * model + scratch + kin + 2 * factor)
