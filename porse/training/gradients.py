"""Gradients written out: of a network's weights, of a maximum, of a clamp; each with the operators that autograd calls."""

from collections.abc import Sequence

import torch
from rsl_rl.models import MLPModel
from torch import Tensor, nn

from porse.training.products import products_on

_SLOPES = {
    nn.ELU: lambda gradient, given, made: torch.ops.aten.elu_backward(gradient, 1.0, 1.0, 1.0, False, given),
    nn.ReLU: lambda gradient, given, made: torch.ops.aten.threshold_backward(gradient, made, 0.0),
    nn.Tanh: lambda gradient, given, made: torch.ops.aten.tanh_backward(gradient, made),
}
"""Gradients of activations, from that of what they made, what they were given, and what they made."""


class Layers:
    """A network of rsl_rl's: linear layers with one activation between them, behind a normaliser.

    Args:
        network: the network; its weights stay its own.
    """

    def __init__(self, network: MLPModel) -> None:
        self.normalise = network.obs_normalizer
        self._linear = [layer for layer in network.mlp if isinstance(layer, nn.Linear)]
        self._activate = network.mlp[1]
        self._slope = _SLOPES[type(self._activate)]
        self._products = products_on(self._linear[0].weight.device)

    def __call__(self, latent: Tensor) -> Tensor:
        """Returns the outputs for normalised observations, and keeps what `learn` needs."""
        self._given, self._made = [], [latent]
        for layer in self._linear[:-1]:
            self._given.append(self._products.outputs(self._made[-1], layer.weight, layer.bias))
            self._made.append(self._activate(self._given[-1]))
        return self._products.outputs(self._made[-1], self._linear[-1].weight, self._linear[-1].bias)

    def learn(self, gradient: Tensor) -> None:
        """Writes the gradients of all weights, from that of the last outputs."""
        for place in reversed(range(len(self._linear))):
            layer = self._linear[place]
            assert layer.weight.grad is not None
            self._products.of_weight(gradient, self._made[place], layer.weight.grad)
            torch.sum(gradient, 0, out=layer.bias.grad)
            if place:
                gradient = self._products.of_inputs(gradient, layer.weight)
                gradient = self._slope(gradient, self._given[place - 1], self._made[place])


def of_larger(first: Tensor, second: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the gradients of two arguments of a maximum; where they are equal, each has a half."""
    shared = torch.where(first == second, gradient / 2, gradient)
    return shared.masked_fill(first < second, 0.0), shared.masked_fill(first > second, 0.0)


def of_clamped(gradient: Tensor, argument: Tensor, low: float, high: float) -> Tensor:
    """Returns the gradient of what was clamped."""
    return torch.where((argument >= low) & (argument <= high), gradient, 0.0)


def shorten(gradients: Sequence[Tensor], most: float) -> None:
    """Multiplies gradients so that all their numbers together are no longer than `most`, as torch's `clip_grad_norm_` does."""
    length = torch.linalg.vector_norm(torch.stack([torch.linalg.vector_norm(gradient) for gradient in gradients]))
    factor = (most / (length + 1e-6)).clamp(max=1.0)
    for gradient in gradients:
        gradient.mul_(factor)
