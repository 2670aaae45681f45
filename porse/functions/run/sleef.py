"""Operators whose bits are the same on every CPU, for functions for which torch has none: `porse::acos_f32_`, ...

They call Sleef, the vector maths inside torch. Torch itself takes it for sines, exponentials and natural logarithms, but
on x86-64 it gives arcs, tangents and decimal logarithms to MKL, whose bits differ between CPUs, and none of its operators
leads to Sleef's. So the loops around Sleef's functions are ours: llvmlite compiles them in a hundredth of a second, without
a compiler on the machine. They hold no arithmetic, and the last numbers of a tensor go the same way as all others, so the
bits are those of Sleef in the pinned torch.
"""

import ctypes
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import llvmlite.binding as llvm
import torch

Function = Literal["acos", "asin", "atan", "tan", "log10"]
Precision = Literal["f32", "f64"]


@dataclass(frozen=True)
class _Vector:
    """Numbers of one type in a register of AVX2: their type in LLVM, in torch (its number there) and in Sleef's names."""

    lanes: int
    element: str
    dtype: int
    suffix: str


_VECTORS: dict[Precision, _Vector] = {"f32": _Vector(8, "float", 6, "f8"), "f64": _Vector(4, "double", 7, "d4")}
_CPU = "x86-64-v3"
"""AVX2 and FMA, whatever the CPU has besides: the code is the same everywhere."""
_SHIM = ("aoti_torch_get_dtype", "aoti_torch_get_numel", "aoti_torch_get_data_ptr", "aoti_torch_check")
"""Torch's stable interface for operators in C, of which the loop calls these."""
_LOOP = """
declare i32 @aoti_torch_get_dtype(ptr, ptr)
declare i32 @aoti_torch_get_numel(ptr, ptr)
declare i32 @aoti_torch_get_data_ptr(ptr, ptr)
declare void @aoti_torch_check(i1, ptr, ptr, i32, ptr)
declare i64 @llvm.umin.i64(i64, i64)
declare <{lanes} x i1> @llvm.get.active.lane.mask.v{lanes}i1.i32(i32, i32)
declare <{lanes} x {element}> @llvm.masked.load.v{lanes}{precision}.p0(ptr, i32, <{lanes} x i1>, <{lanes} x {element}>)
declare void @llvm.masked.store.v{lanes}{precision}.p0(<{lanes} x {element}>, ptr, i32, <{lanes} x i1>)
declare <{lanes} x {element}> @{function}(<{lanes} x {element}>)

@wrong = constant [{length} x i8] c"{wrong}\\00"

; The one tensor on the stack is both argument and result; its numbers lie side by side.
define void @loop(ptr %stack, i64 %arguments, i64 %results) {{
entry:
  %dtype.at = alloca i32
  %count.at = alloca i64
  %numbers.at = alloca ptr
  %tensor = load ptr, ptr %stack
  call i32 @aoti_torch_get_dtype(ptr %tensor, ptr %dtype.at)
  call i32 @aoti_torch_get_numel(ptr %tensor, ptr %count.at)
  call i32 @aoti_torch_get_data_ptr(ptr %tensor, ptr %numbers.at)
  %dtype = load i32, ptr %dtype.at
  %count = load i64, ptr %count.at
  %numbers = load ptr, ptr %numbers.at
  %right = icmp eq i32 %dtype, {dtype}
  call void @aoti_torch_check(i1 %right, ptr @wrong, ptr @wrong, i32 0, ptr @wrong)
  br label %next
next:
  %done = phi i64 [0, %entry], [%more, %vector]
  %left = sub i64 %count, %done
  %any = icmp sgt i64 %left, 0
  br i1 %any, label %vector, label %end
vector:
  %at = getelementptr {element}, ptr %numbers, i64 %done
  %few = call i64 @llvm.umin.i64(i64 %left, i64 {lanes})
  %these = trunc i64 %few to i32
  %mask = call <{lanes} x i1> @llvm.get.active.lane.mask.v{lanes}i1.i32(i32 0, i32 %these)
  %x = call <{lanes} x {element}> @llvm.masked.load.v{lanes}{precision}.p0(ptr %at, i32 1, <{lanes} x i1> %mask, <{lanes} x {element}> zeroinitializer)
  %y = call <{lanes} x {element}> @{function}(<{lanes} x {element}> %x)
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


@functools.cache
def operator(function: Function, precision: Precision) -> str:
    """Returns the name of an operator that writes a function over its argument, made when it is first asked for.

    The operator takes one dense tensor of the precision, of any shape, and returns it.

    Raises:
        RuntimeError: torch refuses the operator.
        AttributeError: this torch has no such function of Sleef's.
    """
    vector, name = _VECTORS[precision], f"{function}_{precision}_"
    sleef = f"Sleef_{function}{vector.suffix}_u10avx2"
    wrong = f"expected a tensor of {vector.element}s for porse::{name}, found one of another type"
    values = {"function": sleef, "precision": precision, "length": len(wrong) + 1, "wrong": wrong}
    address = _compile(_LOOP.format(**values, lanes=vector.lanes, element=vector.element, dtype=vector.dtype), sleef)
    _register(name, address)
    return f"porse::{name}"


@functools.cache
def _torch() -> ctypes.CDLL:
    """Returns torch's library, which holds Sleef and is loaded already."""
    return ctypes.CDLL(str(Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"))


_engines: list[llvm.ExecutionEngine] = []
"""What holds the compiled loops in memory."""


def _compile(text: str, sleef: str) -> int:
    """Returns the address of the loop in a module's text."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    for name in (*_SHIM, sleef):
        address = ctypes.cast(getattr(_torch(), name), ctypes.c_void_p).value
        llvm.add_symbol(name, address)
    target = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(cpu=_CPU)
    module = llvm.parse_assembly(text)
    module.verify()
    engine = llvm.create_mcjit_compiler(module, target)
    engine.finalize_object()
    _engines.append(engine)
    return engine.get_function_address("loop")


def _register(name: str, address: int) -> None:
    """Makes an operator of a loop, in torch's way for operators that are not compiled against it."""
    schemas, loops = ctypes.c_void_p(), ctypes.c_void_p()
    origin = (Path(__file__).name.encode(), 0)
    calls = _torch()
    answers = [
        calls.aoti_torch_library_init_fragment(b"porse", *origin, ctypes.byref(schemas)),
        calls.aoti_torch_library_def(schemas, f"{name}(Tensor(a!) x) -> Tensor(a!)".encode()),
        calls.aoti_torch_library_init_impl(b"porse", b"CPU", *origin, ctypes.byref(loops)),
        calls.aoti_torch_library_impl(loops, name.encode(), ctypes.c_void_p(address)),
    ]
    if any(answers):
        raise RuntimeError(f"expected torch to take the operator porse::{name}, found the answers {answers}")
