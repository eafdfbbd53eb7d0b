"""Algorithm 2: Eq. 15 falls in every half of a round, Ctrl-C and files keep what was found, what it
cannot be given is refused in one line."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from walker import START, walker

import octo
from octo import learn
from octo.errors import OctoError
from octo.problem.compiled import CompiledProblem

STEPS = 30


def swing(x_next, x, x_prev, p):
    """N m and N: a pendulum on a cart, of which the pendulum has no motor."""
    a, way = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2, x_next[1]
    pole = ca.cos(way) * a[0] + p["length"] * a[1] + 9.81 * ca.sin(way)
    return ca.vertcat(1.3 * a[0] + 0.3 * p["length"] * ca.cos(way) * a[1], 0.15 * pole)


@lru_cache
def cart() -> octo.CustomDynamics:
    return octo.CustomDynamics(swing, nx=2, actuated=[0], parameters={"length": 0.5})


def problem(basis: str = "nodes", steps: int = STEPS, **fields: object) -> octo.Problem:
    """The pendulum is to swing to and fro."""
    times = np.arange(1, steps + 1) * 0.05
    to = {"angle": 0.4 * np.sin(4.0 * times)[:, None]}
    track = octo.CustomCost(lambda step, p: step.x_next[1] - p["angle"], to, name="Swing")
    costs = [track, octo.Effort(weight=0.01, reference=1.0)]
    usual = {"steps": steps, "dt": 0.05, "x0": np.zeros(2), "basis": basis, "costs": costs}
    return octo.Problem(cart(), **{**usual, **fields})


def small(**fields: object) -> learn.Transition:
    return learn.Transition(hidden=(12, 12), **fields)


@pytest.mark.slow
def test_eq_15_falls_in_every_half_of_ten_rounds_of_a_walk() -> None:
    costs = octo.costs.paper((0.3, 0.0, 0.0))
    own = octo.Problem(octo.gallery.biped(), steps=60, dt=0.025, basis="hermite", costs=costs)
    found = learn.solve(
        own, small(), rounds=10, iterations=200, training=8, weight=[0.0, *[0.3] * 9]
    )
    assert found.motion.converged and len(found.rounds) == 10
    for one in found.rounds[1:]:
        assert one.accepted and one.between < one.before and one.after < one.between
    for one, following in zip(found.rounds[1:], found.rounds[2:], strict=False):
        np.testing.assert_allclose(following.before, one.after, rtol=1e-9)


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_eq_15_falls_in_every_half_of_ten_rounds(basis: str) -> None:
    own = problem(basis, 60 if basis == "hermite" else STEPS)
    weights = [0.0, 0.3, 0.3, *[1.0] * 7]
    found = learn.solve(own, small(), rounds=10, iterations=40, training=6, weight=weights)
    assert found.motion.converged and len(found.rounds) == 10
    for one in found.rounds:
        assert one.before is None or one.between <= one.before * (1 + 1e-9)
        assert one.after <= one.between * (1 + 1e-12)
    for one, following in zip(found.rounds[3:], found.rounds[4:], strict=False):
        np.testing.assert_allclose(following.before, one.after, rtol=1e-9)
    first, last = found.rounds[3], found.rounds[-1]
    assert last.after < first.before and last.between - last.energy < 0.9 * (
        first.before - first.energy
    )
    # what is written down is what the problem says of the motion
    term = learn.Markovian(transition=found.transition, weight=1.0)
    compiled = CompiledProblem([own.replace(costs=[*own.costs, term])])
    terms = compiled.term_values(compiled.evaluate(found.motion.unknowns[None]))[0]
    np.testing.assert_allclose(terms[:-1].sum(), last.energy, rtol=1e-9)
    matrices = [matrix for matrix, _ in found.transition.layers]
    square = sum((m**2).sum() for m in matrices) / sum(m.size for m in matrices)
    np.testing.assert_allclose(terms.sum() + 1e-2 * square, last.after, rtol=1e-6)


def orbit(periods: int) -> np.ndarray:
    """Controls of a motion that repeats after twelve steps."""
    phase = 2.0 * np.pi * np.arange(-1, 12 * periods + 1) / 12
    x = np.stack([0.2 * np.cos(phase) + 0.05 * np.sin(2.0 * phase), 0.4 * np.sin(phase)], axis=1)
    return np.concatenate([x[1:], np.diff(x, axis=0)], axis=1)


def unrolled_errors(trained: learn.Training, wanted: np.ndarray, horizons: int) -> np.ndarray:
    """Root mean square of each horizon, at equal time."""
    made = trained.transition.unroll(wanted[0], len(wanted) - 1)
    square = ((made - wanted)[1:] ** 2).sum(axis=1).reshape(horizons, -1)
    return np.sqrt(square.mean(axis=1))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_recurrent_loss_stays_for_ten_horizons(seed: int) -> None:
    """Within twice the training error of a motion that repeats; that of single steps does not
    (Fig. 11d)."""
    begun = small(activation="tanh").started(problem(), seed)
    for loss in ("one_step", "recurrent"):
        trained = learn.train(begun, orbit(3), loss=loss, iterations=300, decay=1e-6)
        errors = unrolled_errors(trained, orbit(30), 10) / np.sqrt(trained.error)
        assert trained.loss < 0.01 * trained.first and trained.iterations <= 300
        assert (np.diff(trained.history) <= 0.0).all()
        if loss == "recurrent":
            np.testing.assert_allclose(errors[0], 1.0, rtol=1e-9)
            assert errors.max() < 2.0
        else:
            assert errors[-1] > 4.0


def test_from_nothing_the_recurrent_loss_begins_with_short_pieces() -> None:
    own = problem("hermite", 100)
    trained = learn.train(
        small().started(own), octo.solve(own), loss="recurrent", iterations=400, decay=0.0
    )
    assert trained.loss < 0.02 * trained.first
    numbers = np.arange(14.0).reshape(1, 7, 2)
    found = learn.training.pieces(numbers, 4)
    np.testing.assert_array_equal(found[:, :, 0], [[0, 2, 4, 6, 8], [4, 6, 8, 10, 12]])


def test_a_folder_is_gone_on_from(tmp_path) -> None:
    own, how = problem(), {"iterations": 20, "training": 20}
    seen: list[int] = []
    whole = learn.solve(
        own,
        small(),
        rounds=2,
        weight=1.0,
        callback=lambda found: seen.append(len(found.rounds)),
        **how,
    )
    assert seen == [1, 2]
    whole.save(tmp_path / "walk")
    again = learn.Learned.load(tmp_path / "walk")
    assert again.rounds == whole.rounds and again.error == whole.error
    more = learn.solve(own, resume=tmp_path / "walk", rounds=1, weight=[1.0], **how)
    assert more.rounds[:2] == whole.rounds and len(more.rounds) == 3
    assert more.rounds[2].before <= whole.rounds[1].after * (1 + 1e-9)
    assert "round 3" in str(more)


def test_the_unrolled_motion_is_one_with_its_own_residual() -> None:
    own = problem("hermite", 60)
    found = learn.solve(own, small(), rounds=3, iterations=40, training=200, loss="recurrent")
    made = found.unrolled
    assert made is not None and made.status is octo.Status.UNROLLED and not made.converged
    c = learn.controls(found.motion)
    np.testing.assert_allclose(
        learn.controls(made), found.transition.unroll(c[0], 6), rtol=0, atol=1e-9
    )
    assert made.pointwise_residual > found.motion.pointwise_residual
    np.testing.assert_allclose(found.error**2, found.rounds[-1].unrolled, rtol=1e-12)


def test_ctrl_c_and_a_callback_keep_what_was_found() -> None:
    own = problem()

    found = learn.solve(
        own, small(), rounds=3, iterations=9, training=9, callback=lambda found: True
    )
    assert found.interrupted and len(found.rounds) == 1

    calls: list[np.ndarray] = []
    begun = small().started(own)
    motion = learn.controls(octo.solve(own, max_iterations=20))
    network = learn.training.LOSSES["one_step"]

    def failing(*given: object):
        inner = network(*given)

        def loss(w):
            calls.append(w)
            if len(calls) == 30:
                raise KeyboardInterrupt
            return inner(w)

        return loss

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(learn.training.LOSSES, "one_step", failing)
        trained = learn.train(begun, motion, iterations=200)
    assert trained.interrupted and trained.loss < trained.first


def test_numbers_that_overflow_are_stepped_back_from() -> None:
    """A loss that is not finite away from the start ends a training with the best that was seen."""
    own = problem()
    begun = small().started(own)
    motion = learn.controls(octo.solve(own, max_iterations=20))
    wild = begun.with_weights(30.0 * begun.weights)
    trained = learn.train(wild, motion, loss="recurrent", iterations=20)
    assert np.isfinite(trained.loss) and trained.loss <= trained.first


# -- refused ---------------------------------------------------------------------------------------


def fitted(**changes: object) -> learn.Transition:
    own = small().started(problem())
    return replace(own, fit=replace(own.fit, **changes))


REFUSED = [
    (lambda: learn.solve(problem(), fitted(robot="go2")), "robot is 'go2', the problem's is"),
    (lambda: learn.solve(problem("hermite"), fitted()), "basis is 'nodes', the problem's is"),
    (lambda: learn.solve(problem(dt=0.04), fitted()), "of 0.05 s, from one control"),
    (lambda: learn.solve(problem(), weight=-1.0), "weight is -1.0, must not be negative"),
    (lambda: learn.solve(problem(), weight=[1.0]), "weight has shape (1,)"),
    (lambda: learn.solve(problem(), decay=-1.0), "decay is -1.0, must not be negative"),
    (lambda: learn.solve(problem(), loss="twice"), "loss 'twice'"),
    (lambda: learn.solve(problem(steps=1)), "has 2 controls, must have at least 3"),
    (lambda: learn.solve(problem(), rounds=0), "rounds is 0"),
    (lambda: learn.solve(problem(), max_iterations=3), "must be iterations="),
    (lambda: learn.solve(problem(), callback=3), "callback is 3"),
    (lambda: learn.solve(problem(), resume="nowhere"), "does not exist"),
    (lambda: learn.solve(3), "problem is 3, must be an octo.Problem"),
    (lambda: learn.solve(problem(), 3), "transition is 3, must be an octo.learn.Transition"),
    (lambda: learn.train(fitted(), np.zeros((2, 4))), "must have at least 3 to train on"),
    (lambda: learn.train(fitted(), np.full((5, 4), np.nan)), "motions is not finite at index 0, 0"),
    (lambda: learn.train(fitted(), np.zeros((5, 6))), "motions has shape (5, 6)"),
    (lambda: learn.train(fitted(), []), "motions is an empty list"),
    (lambda: learn.train(learn.Transition(), np.zeros((5, 4))), "has no weights yet"),
    (lambda: learn.Markovian(transition=learn.Transition()), "has no weights yet"),
    (lambda: learn.Markovian(), "transition is None, must be"),
    (lambda: learn.Markovian(transition=fitted(), curvature="exact"), "curvature is given"),
    (lambda: learn.Markovian(transition=fitted(), loss=octo.Huber()), "loss is given"),
    (lambda: learn.Markovian(transition=fitted()).hard(), "has no hard form"),
    (lambda: learn.Transition(hidden=()), "hidden is (), must be a tuple"),
    (lambda: learn.Transition(activation="relu"), "activation"),
    (lambda: learn.Transition(state="mind"), "state"),
    (lambda: learn.Transition(weights=np.zeros(3)), "weights are given without fit"),
    (lambda: fitted().with_weights(np.zeros(3)), "weights has shape (3,)"),
    (lambda: fitted().unroll(np.zeros(3), 2), "c has shape (3,)"),
    (lambda: learn.Transition.load("nowhere.npz"), "does not exist"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_refused_in_one_line(call, words: str) -> None:
    with pytest.raises(OctoError) as error:
        call()
    assert words in str(error.value) and "\n" not in str(error.value)


def of_term(**fields: object) -> octo.Problem:
    own = octo.Problem(
        walker(), **{"steps": 12, "dt": 0.05, "costs": [octo.Effort()], "x0": START, **fields}
    )
    begun = replace(small(), state="world").started(own.replace(cycle=None, duration=None))
    return own.replace(costs=[*own.costs, learn.Markovian(transition=begun)])


def test_where_such_a_term_cannot_be_is_refused() -> None:
    with pytest.raises(OctoError, match="duration is free"):
        CompiledProblem([of_term(duration=(0.5, 0.7))])
    compiled = CompiledProblem([of_term()])
    with pytest.raises(OctoError, match="Markovian is written in arrays, which IPOPT"):
        compiled.check_squares("IPOPT", bounds=True)
    with pytest.raises(OctoError, match="which the controller does not evaluate"):
        octo.mpc.Controller(of_term())
