"""The matrix products of networks, which are most of PPO's arithmetic.

PyTorch's products are MKL's, and MKL gives the same bits on all CPUs only on a path that takes two and a half times as long.
In the profile `portable` the products are therefore NumPy's: its OpenBLAS, which `porse.numerics` holds at the kernels for
AVX2, adds up in the same order on every CPU that has them. In the profile `fast`, and on a GPU, they are PyTorch's.
"""

from abc import ABC, abstractmethod

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from porse import numerics

_SILENT = np.errstate(all="ignore")


class Products(ABC):
    """The products of one linear layer; float32 throughout."""

    @abstractmethod
    def outputs(self, inputs: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """Returns `inputs` (samples, ins) times the transposed `weight` (outs, ins), plus `bias` (outs,)."""

    @abstractmethod
    def of_weight(self, gradient: Tensor, inputs: Tensor, out: Tensor) -> None:
        """Writes the weight's gradient (outs, ins) to `out`, from that of the outputs (samples, outs)."""

    @abstractmethod
    def of_inputs(self, gradient: Tensor, weight: Tensor) -> Tensor:
        """Returns the inputs' gradient (samples, ins), from that of the outputs (samples, outs)."""


class TorchProducts(Products):
    """PyTorch's products, on any device."""

    def outputs(self, inputs: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """See `Products.outputs`."""
        return functional.linear(inputs, weight, bias)

    def of_weight(self, gradient: Tensor, inputs: Tensor, out: Tensor) -> None:
        """See `Products.of_weight`."""
        torch.mm(gradient.t(), inputs, out=out)

    def of_inputs(self, gradient: Tensor, weight: Tensor) -> Tensor:
        """See `Products.of_inputs`."""
        return gradient.mm(weight)


class NumpyProducts(Products):
    """NumPy's products, on the memory of PyTorch's tensors; like PyTorch's, they are silent where a number overflows."""

    @_SILENT
    def outputs(self, inputs: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """See `Products.outputs`."""
        made = torch.empty(inputs.shape[0], weight.shape[0])  # len() of a tensor takes microseconds
        np.matmul(inputs.numpy(), weight.detach().numpy().T, out=made.numpy())
        return made.add_(bias.detach())

    @_SILENT
    def of_weight(self, gradient: Tensor, inputs: Tensor, out: Tensor) -> None:
        """See `Products.of_weight`."""
        np.matmul(gradient.numpy().T, inputs.numpy(), out=out.numpy())

    @_SILENT
    def of_inputs(self, gradient: Tensor, weight: Tensor) -> Tensor:
        """See `Products.of_inputs`."""
        made = torch.empty(gradient.shape[0], weight.shape[1])
        np.matmul(gradient.numpy(), weight.detach().numpy(), out=made.numpy())
        return made


def products_on(device: torch.device) -> Products:
    """Returns the products of this process's numeric profile on a device."""
    if device.type == "cpu" and numerics.applied() == "portable":
        return NumpyProducts()
    return TorchProducts()
