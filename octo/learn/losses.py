"""What a network is trained on: Eq. 14, or Eq. 16 by back-propagation through all controls; each
gives its value and its gradient with respect to the weights."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from octo.checks import Array
from octo.learn.frame import Frame
from octo.learn.network import Network

# weights (count,) -> the loss and its gradient (count,)
Loss = Callable[[Array], tuple[float, Array]]


def one_step(
    network: Network, frame: Frame, controls: Array, commands: Array | None = None
) -> Loss:
    """The mean of |c_{i+1} − RNN(c_i)|² (Eq. 14) over the transitions of motions (…, Z + 1, 2n);
    commands (…, G) are further inputs of each of them."""
    c, c_next = controls[..., :-1, :], controls[..., 1:, :]
    told = None if commands is None else commands[..., None, :]
    s = np.ascontiguousarray(_told(frame.inputs(c), told).reshape(-1, network.sizes[0]))
    wanted = frame.change(c, c_next).reshape(len(s), -1)

    def loss(w: Array) -> tuple[float, Array]:
        layers = network.layers(w)
        value, trace = network.traced(layers, s)
        r = value - wanted
        pulls, _ = network.back(layers, trace, (2.0 / len(s)) * r)
        return float((r**2).sum() / len(s)), network.gradient(trace.inputs, pulls)

    return loss


def recurrent(
    network: Network, frame: Frame, controls: Array, commands: Array | None = None
) -> Loss:
    """The mean of |c_{i+1} − RNN^i(c_0)|² (Eq. 16) over the controls of motions (…, Z + 1, 2n),
    each unrolled from its first one; commands (…, G) are further inputs of each transition."""
    wanted = np.ascontiguousarray(controls.reshape(-1, *controls.shape[-2:]))
    motions, steps = wanted.shape[0], wanted.shape[1] - 1
    count = motions * steps
    told = None if commands is None else commands.reshape(motions, -1)
    seen = len(frame.kept)

    def loss(w: Array) -> tuple[float, Array]:
        layers = network.layers(w)
        c, way = wanted[:, 0], []
        total = 0.0
        for k in range(steps):
            f, trace = network.traced(layers, _told(frame.inputs(c), told))
            following = frame.following(c, f)
            r = (following - wanted[:, k + 1]) / frame.sizes
            way.append((c, f, trace, r))
            total += float((r**2).sum())
            c = following
        pull = np.zeros_like(c)
        pulls: list[list[Array]] = []
        for c, f, trace, r in reversed(way):
            of_f, pull = frame.pulled_following(c, f, pull + (2.0 / count) * r / frame.sizes)
            own, of_s = network.back(layers, trace, of_f)
            pulls.append(own)
            pull = pull + frame.pulled_inputs(c, of_s[..., :seen])
        inputs = [np.concatenate(one) for one in zip(*(t.inputs for *_, t, _ in way), strict=True)]
        joined = [np.concatenate(one) for one in zip(*reversed(pulls), strict=True)]
        return total / count, network.gradient(inputs, joined)

    return loss


def _told(s: Array, commands: Array | None) -> Array:
    """Inputs (…, inputs) with the numbers of commands (…, G) behind them."""
    if commands is None:
        return s
    own = np.broadcast_to(commands, (*s.shape[:-1], commands.shape[-1]))
    return np.concatenate([s, own], axis=-1)


LOSSES: dict[str, Callable[[Network, Frame, Array, Array | None], Loss]] = {
    "one_step": one_step,
    "recurrent": recurrent,
}


def with_decay(loss: Loss, network: Network, decay: float) -> Loss:
    """``loss`` and ``decay`` times the mean square of the matrices' entries."""
    if decay == 0.0:
        return loss
    sizes = [matrix.size for matrix, _ in network.layers(np.empty(network.count))]
    share = decay / sum(sizes)

    def decayed(w: Array) -> tuple[float, Array]:
        value, gradient = loss(w)
        for (matrix, _), (made, _) in zip(network.layers(w), network.layers(gradient), strict=True):
            own = matrix.ravel()
            value += share * float(own @ own)
            made += (2.0 * share) * matrix
        return value, gradient

    return decayed
