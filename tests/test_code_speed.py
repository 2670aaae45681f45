"""What a validated function costs per call, against the same function scripted by hand."""

import importlib.util
import time
import warnings

import pytest
import torch

from code_cases import VARIABLES, values
from porse.code.compile import compile_reward

SOURCES = {
    "short": """
def compute_reward(a: Tensor, b: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    d = torch.norm(a - b, dim=-1)
    temperature = 0.1
    r = torch.exp(-d / temperature)
    return r, {"r": r}
""",
    "usual": """
def compute_reward(a: Tensor, b: Tensor, q: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    distance = torch.norm(a - b, p=2, dim=-1)
    distance_temperature = 5.0
    near = torch.exp(-distance_temperature * distance)
    speed = torch.norm(b, p=2, dim=-1)
    speed_temperature = 0.5
    slow = -torch.tanh(speed_temperature * speed)
    effort = -0.0002 * torch.sum(q ** 2, dim=-1)
    bonus = torch.where(distance < 0.05, torch.ones_like(distance), torch.zeros_like(distance))
    total = near + 0.1 * slow + effort + 5.0 * bonus
    return total, {"near": near, "slow": slow, "effort": effort, "bonus": bonus}
""",
    "helpers": """
def turn(p: Tensor, q: Tensor) -> Tensor:
    return 1.0 - torch.sum(p * q, dim=-1).abs().clamp(max=1.0)

def compute_reward(a: Tensor, b: Tensor, q: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    near = torch.exp(-10.0 * torch.norm(a - b, dim=-1))
    turned = torch.exp(-2.0 * turn(q, q))
    return near + 0.5 * turned, {"near": near, "turned": turned}
""",
    "sqrt and acos": """
def compute_reward(a: Tensor, b: Tensor, q: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    distance = torch.sqrt(torch.sum((a - b) ** 2, dim=-1))
    angle = 2 * torch.acos(torch.clamp(q[:, 3].abs(), max=1.0))
    near = torch.exp(-distance / 0.1)
    turned = torch.exp(-angle / 0.5)
    return near + turned, {"near": near, "turned": turned}
""",
    "sqrt and acos, whole numbers": """
def compute_reward(a: Tensor, b: Tensor, q: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    distance = torch.sqrt(torch.sum((a - b) ** 2, dim=-1))
    angle = 2 * torch.acos(torch.clamp(q[:, 3].abs(), max=1))
    return torch.exp(-distance) + torch.exp(-angle), {"distance": distance, "angle": angle}
""",
    "sqrt and asin": """
def compute_reward(a: Tensor, b: Tensor, q: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    distance = torch.sqrt(torch.sum((a - b) ** 2, dim=-1) + 1e-6)
    angle = 2.0 * torch.asin(torch.clamp(torch.norm(q[:, 0:3], p=2, dim=-1), max=1.0))
    total = 1.0 / (torch.abs(angle) + 0.1) - distance
    return total, {"total": total}
""",
}
ENVIRONMENTS = 1024


def scripted_by_hand(source, folder):
    """Returns the function as a person would write it: imported from a file and given to torch.jit.script."""
    path = folder / "by_hand.py"
    path.write_text(f"import torch\nfrom torch import Tensor\nfrom typing import Dict, Tuple\n{source}")
    spec = importlib.util.spec_from_file_location("by_hand", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return torch.jit.script(module.compute_reward)


def microseconds(call, rounds):
    started = time.perf_counter()
    for _ in range(rounds):
        call()
    return (time.perf_counter() - started) / rounds * 1e6


def quiet_ratio(first, second):
    """Returns how many times longer `second` takes, from the third of the turns that took least, both in each."""
    for call in (first, second):
        microseconds(call, 200)
    turns = sorted(((microseconds(first, 10), microseconds(second, 10)) for _ in range(600)), key=sum)[:200]
    return sum(turn[1] for turn in turns) / sum(turn[0] for turn in turns)


@pytest.mark.slow
@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("name", SOURCES)
def test_a_call_costs_at_most_15_percent_more_than_by_hand(name, portable, tmp_path):
    """Slow only because it wants the machine for itself."""
    states = values(ENVIRONMENTS)
    ours = compile_reward(SOURCES[name], VARIABLES, portable)
    by_hand = scripted_by_hand(SOURCES[name], tmp_path)
    given = [states[argument] for argument in ours.arguments]

    def hand():
        torch._C._set_graph_executor_optimize(True)  # as it is by default
        return by_hand(*given)

    with torch.inference_mode():
        assert quiet_ratio(hand, lambda: ours(states)) <= 1.15


BARE = """
def compute_reward(q: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    r = torch.acos(q[:, 0]) + torch.acos(q[:, 1])
    return r, {"r": r}
"""
BARE_WITH_PORTABLE_BITS = """
def arc_cosine(x: Tensor) -> Tensor:
    one = torch.ones(1)
    return torch.atan2(one, torch.rsqrt(torch.addcmul(one, x, x, value=-1)) * x)

def compute_reward(q: Tensor) -> Tuple[Tensor, Dict[str, Tensor]]:
    r = arc_cosine(q[:, 0]) + arc_cosine(q[:, 1])
    return r, {"r": r}
"""


def ratio_of_bare_arc_cosines(portable, written, folder):
    """Returns how many times longer BARE takes than the source `written`, scripted by hand."""
    states = values(ENVIRONMENTS)
    states["q"] = torch.nn.functional.normalize(states["q"], dim=-1)  # inside the domain
    ours = compile_reward(BARE, VARIABLES, portable)
    by_hand = scripted_by_hand(written, folder)

    def hand():
        torch._C._set_graph_executor_optimize(True)  # as it is by default
        return by_hand(states["q"])

    with torch.inference_mode():
        return quiet_ratio(hand, lambda: ours(states))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("portable", "written"), [(False, BARE), (True, BARE_WITH_PORTABLE_BITS)], ids=["fast", "portable"]
)
def test_bare_arc_cosines_cost_at_most_15_percent_more_than_the_same_bits_by_hand(portable, written, tmp_path):
    assert ratio_of_bare_arc_cosines(portable, written, tmp_path) <= 1.15


@pytest.mark.slow
@pytest.mark.xfail(reason="two arc cosines and nothing else cost about 1.6 times as much in the profile portable")
def test_bare_arc_cosines_in_portable_cost_at_most_15_percent_more_than_plain_ones_by_hand(tmp_path):
    """Each is four operators, and torch has no way to fewer (docs/decisions.md)."""
    assert ratio_of_bare_arc_cosines(True, BARE, tmp_path) <= 1.15
