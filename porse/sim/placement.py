"""Where tensors are made: on the device of the physics, without a word about it in the tasks.

Tasks, rewards and PPO are written as if there were one place for tensors. Within `placed(device)` what they make is made
there, and what they bring along, a module's constant, a list of indices, a literal, is copied there once: a copy in every
step would make the processor wait for the device each time.
"""

import contextlib
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

_FACTORIES = frozenset(
    (torch.arange, torch.empty, torch.eye, torch.full, torch.linspace, torch.ones, torch.rand, torch.randint, torch.randn,
     torch.randperm, torch.zeros)
)  # fmt: skip
_MOVES = frozenset(
    (Tensor.clone, Tensor.copy_, Tensor.cpu, Tensor.cuda, Tensor.detach, Tensor.numpy, Tensor.set_, Tensor.to)
)  # fmt: skip
"""Functions that take tensors where they are: checkpoints come and go by them."""

_MOST_KEPT = 512
"""Constants that are kept on the device; a program has some dozens."""


def placed(device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Returns a context in which tensors are made on `device`; for the CPU it does nothing, and costs nothing."""
    return contextlib.nullcontext() if device.type == "cpu" else _Placed(device)


@contextlib.contextmanager
def unplaced() -> Iterator[None]:
    """Lets tensors be made on the processor again, within `placed`: those of a module, which outlive the context."""
    before, _Placed.is_idle = _Placed.is_idle, True
    try:
        yield
    finally:
        _Placed.is_idle = before


class _Placed(TorchFunctionMode):
    """Gives factories the device, and takes constants there, unless it `is_idle`."""

    is_idle: ClassVar[bool] = False

    def __init__(self, device: torch.device) -> None:
        super().__init__()
        self._device = device
        self._kept: OrderedDict[Any, tuple[Any, Tensor]] = OrderedDict()

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        """Calls `func` with what it needs on the device."""
        named = dict(kwargs or {})
        if self.is_idle:
            return func(*args, **named)
        if func is torch.tensor and named.get("device") is None:
            return self._literal(args[0], named)
        if func in _FACTORIES and named.get("device") is None:
            named["device"] = self._device
        elif func is Tensor.__getitem__ or func is Tensor.__setitem__:
            args = (args[0], self._index(args[1]), *args[2:])
        if func not in _MOVES and getattr(func, "__name__", "") != "__get__":
            # Even where all of it is elsewhere: what is made of constants in every step would else be copied in every step.
            args, named = self._moved(tuple(args)), {name: self._moved(value) for name, value in named.items()}
        return func(*args, **named)

    def _index(self, index: Any) -> Any:
        """Returns an index with its lists, and its tensors of elsewhere, as tensors on the device."""
        if isinstance(index, list):
            return self._literal(index, {})
        if isinstance(index, tuple):
            # A tuple within the tuple is a list of indices as well.
            return tuple(self._index([*part] if isinstance(part, tuple) else part) for part in index)
        return self._moved(index)

    def _moved(self, value: Any) -> Any:
        """Returns an argument with its tensors on the device; a number in a tensor of its own may stay where it is."""
        if isinstance(value, Tensor):
            return self._constant(value) if value.device.type == "cpu" and value.dim() else value
        return type(value)(map(self._moved, value)) if type(value) in (tuple, list) else value

    def _constant(self, value: Tensor) -> Tensor:
        version = 0 if value.is_inference() else value._version
        key = value.data_ptr(), value.shape, value.stride(), value.dtype, version
        # The constant itself is kept, too: nothing else can come to lie where it lies.
        return self._once(key, value, lambda: value.detach().to(self._device))

    def _literal(self, data: Any, named: Mapping[str, Any]) -> Tensor:
        """Returns what `torch.tensor` makes of numbers, in memory of its own."""
        if isinstance(data, Tensor):
            return data.detach().to(self._device, named.get("dtype") or data.dtype, copy=True)
        key = _hashable(data), named.get("dtype")
        made = self._once(key, None, lambda: torch.tensor(data, **{**named, "device": "cpu"}).to(self._device))
        return made.clone()

    def _once(self, key: Any, source: Any, make: Callable[[], Tensor]) -> Tensor:
        if key not in self._kept:
            with torch.inference_mode(False):
                self._kept[key] = source, make()
            if len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
        else:
            self._kept.move_to_end(key)
        return self._kept[key][1]


def _hashable(data: Any) -> Any:
    """Returns nested lists of numbers as tuples, in which 1, 1.0 and True differ."""
    if isinstance(data, tuple | list):
        return tuple(_hashable(part) for part in data)
    return type(data), repr(data)
