"""A fully connected network as pure functions of its weights: values, slopes and the gradient of
its weights, of many inputs at once, in NumPy or on a device.

Weights are one vector w, which an optimiser sees: of each layer the matrix (out, in), row by row,
then the bias (out,).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from octo.arrays import Array, array_module

LAST = 1e-3  # of the output layer at the start: it changes nothing yet
SAMPLES = 256  # of normally distributed inputs, by which biases are found
LARGE = 36.0  # from here on softplus(z) is z, to the last bit


def softplus(z: Array) -> tuple[Array, Array]:
    """log(1 + exp(z)) (Dugas et al. 2000) and its derivative."""
    xp = array_module(z)
    grown = xp.exp(xp.minimum(z, LARGE))
    return xp.maximum(xp.log(1.0 + grown), z), grown / (1.0 + grown)


def tanh(z: Array) -> tuple[Array, Array]:
    """Its value and its derivative."""
    value = array_module(z).tanh(z)
    return value, 1.0 - value**2


ACTIVATIONS: dict[str, Callable[[Array], tuple[Array, Array]]] = {
    "softplus": softplus,
    "tanh": tanh,
}


@dataclass(frozen=True)
class Trace:
    """What a pass forward leaves for the way back: of each layer its input (…, in) and, but for the
    last, the derivative of its activation (…, out)."""

    inputs: list[Array]
    slopes: list[Array]


@dataclass(frozen=True)
class Network:
    """The sizes of the layers, inputs and outputs included, and what stands between them."""

    sizes: tuple[int, ...]
    activation: str = "softplus"

    @cached_property
    def count(self) -> int:
        """How many weights there are."""
        return sum(m * (k + 1) for k, m in self._pairs)

    @property
    def _pairs(self) -> list[tuple[int, int]]:
        return list(zip(self.sizes, self.sizes[1:], strict=False))

    @property
    def _function(self) -> Callable[[Array], tuple[Array, Array]]:
        return ACTIVATIONS[self.activation]

    def layers(self, w: Array) -> list[tuple[Array, Array]]:
        """The matrices (out, in) and biases (out,), which are views of w (count,)."""
        made, at = [], 0
        for k, m in self._pairs:
            made.append((w[at : at + m * k].reshape(m, k), w[at + m * k : at + m * (k + 1)]))
            at += m * (k + 1)
        return made

    def started(self, seed: int) -> Array:
        """(count,) weights to begin with: normally distributed, of variance 2/in (He et al. 2015),
        those of the output layer very small: all of them small would be a saddle.

        Biases take the mean of each layer away, which softplus would add to in every layer: 400
        iterations then lower Eq. 14 of a biped's walk to 2e-11, in place of 0.05.
        """
        random, w = np.random.default_rng(seed), np.zeros(self.count)
        layers = self.layers(w)
        for matrix, _ in layers:
            matrix[:] = random.standard_normal(matrix.shape) * np.sqrt(2.0 / matrix.shape[1])
        layers[-1][0][:] *= LAST
        s = random.standard_normal((SAMPLES, self.sizes[0]))
        for matrix, bias in layers:
            z = s @ matrix.T
            bias[:] = -z.mean(axis=0)
            s = self._function(z + bias)[0]
        return w

    def value(self, layers: Sequence[tuple[Array, Array]], s: Array) -> Array:
        """(…, out) of inputs s (…, in)."""
        return self.traced(layers, s)[0]

    def traced(self, layers: Sequence[tuple[Array, Array]], s: Array) -> tuple[Array, Trace]:
        """(…, out) of inputs s (…, in), and what the way back needs."""
        inputs, slopes = [s], []
        for matrix, bias in layers[:-1]:
            value, slope = self._function(inputs[-1] @ matrix.T + bias)
            inputs.append(value)
            slopes.append(slope)
        matrix, bias = layers[-1]
        return inputs[-1] @ matrix.T + bias, Trace(inputs, slopes)

    def slopes(self, layers: Sequence[tuple[Array, Array]], s: Array) -> tuple[Array, Array]:
        """(…, out) of inputs s (…, in), and their slopes (…, out, in)."""
        value, trace = self.traced(layers, s)
        out = layers[-1][0] * trace.slopes[-1][..., None, :]
        for (matrix, _), slope in zip(layers[-2:0:-1], trace.slopes[-2::-1], strict=True):
            out = (out @ matrix) * slope[..., None, :]
        return value, out @ layers[0][0]

    def back(
        self, layers: Sequence[tuple[Array, Array]], trace: Trace, pull: Array
    ) -> tuple[list[Array], Array]:
        """What ``pull`` (…, out), the gradient of some number with respect to the outputs, is at
        each layer (…, out of the layer) before its activation, and at the inputs (…, in)."""
        pulls = [pull]
        for (matrix, _), slope in zip(layers[:0:-1], trace.slopes[::-1], strict=True):
            pulls.append((pulls[-1] @ matrix) * slope)
        pulls.reverse()
        return pulls, pulls[0] @ layers[0][0]

    def gradient(self, inputs: Sequence[Array], pulls: Sequence[Array]) -> Array:
        """(count,) of the weights, from the inputs (m, in) of each layer and the pulls (m, out)
        there."""
        xp = array_module(pulls[0])
        made = xp.empty(self.count)
        for (matrix, bias), own, pull in zip(self.layers(made), inputs, pulls, strict=True):
            xp.matmul(pull.T, own, out=matrix)
            bias[:] = pull.sum(axis=0)
        return made
