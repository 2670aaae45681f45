"""Functions whose bits are the same on every CPU, and for which torch has none: Sleef's, the vector maths inside torch.

Torch itself takes Sleef for sines, exponentials and natural logarithms, but on x86-64 it gives arcs, tangents and decimal
logarithms to MKL, whose bits differ between CPUs, and none of its operators leads to Sleef's. So the loops around Sleef's
functions are ours: llvmlite compiles them in a hundredth of a second, without a compiler on the machine. They hold no
arithmetic, and the last numbers of a tensor go the same way as all others, so the bits are those of Sleef in the pinned torch.
"""

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import llvmlite.binding as llvm
import torch
from torch import Tensor

Function = Literal["acos", "asin", "atan", "tan", "log10"]
Precision = Literal["f32", "f64"]

_VECTORS: dict[Precision, tuple[int, str, str]] = {"f32": (8, "float", "f8"), "f64": (4, "double", "d4")}
"""Numbers in a register of AVX2, their type in LLVM, and both in Sleef's names."""
_CPU = "x86-64-v3"
"""AVX2 and FMA, whatever the CPU has besides: the code is the same everywhere."""
_LOOP = """
declare <{lanes} x i1> @llvm.get.active.lane.mask.v{lanes}i1.i64(i64, i64)
declare <{lanes} x {element}> @llvm.masked.load.v{lanes}{precision}.p0(ptr, i32, <{lanes} x i1>, <{lanes} x {element}>)
declare void @llvm.masked.store.v{lanes}{precision}.p0(<{lanes} x {element}>, ptr, i32, <{lanes} x i1>)
declare <{lanes} x {element}> @{sleef}(<{lanes} x {element}>)

define void @loop(ptr %numbers, i64 %count) {{
entry:
  br label %next
next:
  %done = phi i64 [0, %entry], [%more, %vector]
  %any = icmp slt i64 %done, %count
  br i1 %any, label %vector, label %end
vector:
  %at = getelementptr {element}, ptr %numbers, i64 %done
  %mask = call <{lanes} x i1> @llvm.get.active.lane.mask.v{lanes}i1.i64(i64 %done, i64 %count)
  %x = call <{lanes} x {element}> @llvm.masked.load.v{lanes}{precision}.p0(ptr %at, i32 1, <{lanes} x i1> %mask, <{lanes} x {element}> zeroinitializer)
  %y = call <{lanes} x {element}> @{sleef}(<{lanes} x {element}> %x)
  call void @llvm.masked.store.v{lanes}{precision}.p0(<{lanes} x {element}> %y, ptr %at, i32 1, <{lanes} x i1> %mask)
  %more = add i64 %done, {lanes}
  br label %next
end:
  ret void
}}
"""


def is_needed() -> bool:
    """Returns whether torch gives functions to MKL here, on a CPU with AVX2, which `portable` and Sleef's forms ask for."""
    return torch.backends.mkl.is_available() and torch.backends.cpu.get_cpu_capability() != "DEFAULT"


def function(name: Function) -> Callable[[Tensor], Tensor]:
    """Returns a function of a tensor of any shape and type, which is left as it is; integers become floats, as in torch."""

    def apply(x: Tensor) -> Tensor:
        copy = torch.mul(x, 1.0)  # dense, whatever x is
        if copy.device.type != "cpu":
            raise ValueError(f"expected a tensor on the CPU for Sleef's {name}, found one on {copy.device}")
        precision: Precision = "f64" if copy.dtype is torch.float64 else "f32"
        dense = copy if copy.dtype in (torch.float32, torch.float64) else copy.float()
        operator(name, precision)(dense.data_ptr(), dense.numel())
        return dense.type_as(copy)

    return apply


@functools.cache
def operator(function: Function, precision: Precision) -> Callable[[int, int], None]:
    """Returns a function written over so many numbers at an address, a loop that is made when it is first asked for.

    Raises:
        AttributeError: this torch has no such function of Sleef's.
    """
    lanes, element, suffix = _VECTORS[precision]
    sleef = f"Sleef_{function}{suffix}_u10avx2"
    torch_cpu = ctypes.CDLL(str(Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"))  # is loaded, and holds Sleef
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    llvm.add_symbol(sleef, ctypes.cast(getattr(torch_cpu, sleef), ctypes.c_void_p).value)
    target = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(cpu=_CPU)
    module = llvm.parse_assembly(_LOOP.format(lanes=lanes, element=element, precision=precision, sleef=sleef))
    module.verify()
    engine = llvm.create_mcjit_compiler(module, target)
    engine.finalize_object()
    loop = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64)(engine.get_function_address("loop"))
    vars(loop)["engine"] = engine  # holds the loop in memory
    return loop
