"""The products of networks: what they are, and that in the profile `portable` they are the same on all vendors' CPUs."""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from porse import numerics
from porse.errors import ParamsError
from porse.training.products import NumpyProducts, TorchProducts, products_on

ROOT = Path(__file__).resolve().parent.parent
SIZES = [
    (1, 13, 64),
    (128, 13, 64),
    (129, 64, 1),
    (7, 5, 3),
    (1024, 64, 64),
    (1030, 64, 4),
    (512, 211, 128),
    (40, 422, 256),
    (300, 256, 52),
]
"""Samples, ins and outs: blocks of the library and what is left beside them."""


@pytest.fixture(params=[NumpyProducts(), TorchProducts()], ids=["numpy", "torch"])
def products(request):
    return request.param


def test_a_layer_and_its_gradients_worked_out_by_hand(products):
    inputs, weight = (
        torch.tensor([[1.0, 2.0, 3.0], [-1.0, 0.0, 4.0]]),
        torch.tensor([[1.0, 0.0, -2.0], [3.0, 5.0, 7.0]]),
    )
    bias, gradient, written = (
        torch.tensor([10.0, 0.5]),
        torch.tensor([[1.0, 2.0], [3.0, -1.0]]),
        torch.full((2, 3), 9.0),
    )
    # 1 - 6 + 10, 3 + 10 + 21 + 0.5; -1 - 8 + 10, -3 + 28 + 0.5
    assert products.outputs(inputs, weight, bias).tolist() == [[5.0, 34.5], [1.0, 25.5]]
    products.of_weight(gradient, inputs, written)
    # 1 * 1 + 3 * -1, 1 * 2, 1 * 3 + 3 * 4; 2 * 1 - 1 * -1, 2 * 2, 2 * 3 - 4
    assert written.tolist() == [[-2.0, 2.0, 15.0], [3.0, 4.0, 2.0]]
    # 1 + 6, 10, -2 + 14; 3 - 3, -5, -6 - 7
    assert products.of_inputs(gradient, weight).tolist() == [[7.0, 10.0, 12.0], [0.0, -5.0, -13.0]]


@pytest.mark.parametrize(("samples", "ins", "outs"), SIZES)
def test_products_are_those_of_double_precision_within_rounding(products, samples, ins, outs):
    inputs, weight, bias, gradient = factors(samples, ins, outs)
    written = torch.empty(outs, ins)
    products.of_weight(gradient, inputs, written)
    for found, wanted in (
        (products.outputs(inputs, weight, bias), inputs.double() @ weight.double().T + bias.double()),
        (written, gradient.double().T @ inputs.double()),
        (products.of_inputs(gradient, weight), gradient.double() @ weight.double()),
    ):
        assert found.dtype == torch.float32
        assert found.is_contiguous()
        torch.testing.assert_close(found.double(), wanted, rtol=1e-4, atol=1e-4)


def test_numbers_that_overflow_are_infinite_and_nobody_is_warned(products):
    huge, written = torch.full((2, 2), 1e30), torch.empty(2, 2)
    products.of_weight(huge, huge, written)
    for made in (products.outputs(huge, huge, torch.zeros(2)), products.of_inputs(huge, huge), written):
        assert made.tolist() == [[float("inf")] * 2] * 2


def test_the_profile_chooses_the_products(monkeypatch):
    assert numerics.applied() == "portable"
    assert isinstance(products_on(torch.device("cpu")), NumpyProducts)
    assert isinstance(products_on(torch.device("cuda:0")), TorchProducts)
    monkeypatch.delenv("OPENBLAS_CORETYPE")
    assert numerics.applied() == "fast"
    assert isinstance(products_on(torch.device("cpu")), TorchProducts)


def test_the_profile_must_be_set_before_numpy(monkeypatch):
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Zen")
    monkeypatch.delitem(sys.modules, "torch")
    with pytest.raises(ParamsError, match="numpy loaded and OPENBLAS_CORETYPE set otherwise"):
        numerics.apply("portable")


def test_a_program_may_read_its_parameters_after_numpy_if_it_prepares(monkeypatch):
    """As `porse run` does: PyArrow imports NumPy."""
    text = "from porse import numerics; {}; import numpy; numerics.apply('portable'); print(numerics.applied())"
    plain = {name: value for name, value in os.environ.items() if name not in numerics.ENVIRONMENT["portable"]}
    done = [
        subprocess.run([sys.executable, "-c", text.format(how)], env=plain, cwd=ROOT, capture_output=True, text=True)
        for how in ("numerics.prepare()", "pass")
    ]
    assert done[0].stdout == "portable\n"
    assert done[1].returncode
    assert "before numpy is loaded" in done[1].stderr
    monkeypatch.setattr(numerics, "cpu_flags", lambda: {"avx"})
    monkeypatch.delitem(sys.modules, "numpy")
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Sandybridge")
    numerics.prepare()
    assert os.environ["OPENBLAS_CORETYPE"] == "Sandybridge"


@pytest.mark.slow
@pytest.mark.parametrize("cpu", ["Haswell", "EPYC", "Skylake-Client", "EPYC-Milan"])
def test_products_have_the_same_bits_on_another_vendors_cpu(cpu):
    emulator = shutil.which("qemu-x86_64")
    if emulator is None:
        pytest.fail("expected qemu-x86_64, found none; install Debian's qemu-user, then run this again")
    command = [sys.executable, str(Path(__file__).resolve())]
    native, other = (
        subprocess.run([*before, *command], check=True, capture_output=True, text=True, cwd=ROOT).stdout.splitlines()
        for before in ([], [emulator, "-cpu", cpu])
    )
    assert len(native) == 3 * len(SIZES)
    assert other == native


def factors(samples, ins, outs):
    """Inputs, weight, bias and gradient of a layer, from a generator whose draws are the same everywhere."""
    torch.manual_seed(samples + 7 * ins + 11 * outs)
    return (
        torch.rand(samples, ins) - 0.4,
        torch.rand(outs, ins) - 0.5,
        torch.rand(outs),
        torch.rand(samples, outs) - 0.6,
    )


def main():
    """Prints a hash of each product of each size."""
    for size in SIZES:
        inputs, weight, bias, gradient = factors(*size)
        written, products = torch.empty(size[2], size[1]), products_on(torch.device("cpu"))
        products.of_weight(gradient, inputs, written)
        for made in (products.outputs(inputs, weight, bias), written, products.of_inputs(gradient, weight)):
            print(hashlib.sha256(made.numpy().tobytes()).hexdigest())


if __name__ == "__main__":
    main()
