"""From a reply to an operator list: extraction, the static check, the trace. In a confined process only."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from porse.functions.read.check import check_source
from porse.functions.read.extract import extract
from porse.functions.read.source import parse
from porse.functions.read.trace import trace
from porse.functions.verdict import Check, CodeError, Kind
from porse.variables import Variable


@dataclass(frozen=True)
class Read:
    """What a reply held.

    Attributes:
        program: the text of the operator list, "" when it was refused.
        source: the function's own text, "" when it was refused.
        check: the check that refused it.
        message: why.
        line: the line of the reply that the refusal, or one of the list, is about; 0 for none.
    """

    program: str = ""
    source: str = ""
    check: Check = "ok"
    message: str = ""
    line: int = 0


def read_reply(reply: str, kind: Kind, variables: Sequence[Variable], values: Mapping[str, Any]) -> Read:
    """Returns the operator list of the function in a reply, or why there is none.

    Args:
        reply: the whole text.
        kind: what it should hold.
        variables: what the task offers.
        values: the value of each variable in real states.
    """
    extracted = None
    try:
        extracted = extract(reply, kind)
        source = parse(extracted.source)
        check_source(source, {variable.name: variable for variable in variables})
        program = trace(source, kind, values)
    except CodeError as error:
        line = error.line if extracted is None else extracted.line_of(error.line)
        return Read(check=error.check, message=str(error), line=line)
    return Read(program.text, extracted.source, line=extracted.line_of(source.last_line))


def warm_up() -> tuple[str, dict[str, Any]]:
    """Has Python and torch prepare what they prepare once, so that no function needs a file later.

    Returns:
        A list, and states to try it on, for who tries lists to do the same.
    """
    variables = [Variable("x", "tensor", (3,), "1", "world", "")]
    values = {"x": torch.linspace(-1.0, 1.0, 48).reshape(16, 3), "num_envs": 16}
    source = (
        "def compute_reward(x):\n"
        "    d = torch.norm(x, dim=-1) + torch.norm(x, p=2, dim=1) + torch.norm(x) + torch.einsum('ij,ij->i', x, x)\n"
        "    p, q = torch.split(x, [1, 2], dim=-1)\n"
        "    s = torch.split(x, 1, dim=-1)[0] + F.normalize(x, dim=-1) + torch.cdist(x[:9], x[:9]).sum()\n"
        "    u, v = torch.broadcast_tensors(x, x)\n"
        "    s = s + F.softplus(x) + F.huber_loss(x, q.sum()) + F.gelu(x) + torch.special.expit(x)\n"
        "    return torch.exp(-d) + p.sum() + s.sum() + u.sum() + torch.atleast_1d(x).sum(-1), {f'd_{0.5:.1f}': d}\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for text in ("def compute_reward(x:\n", source.replace("q.sum()", "q.sum().item()"), source):
            found = read_reply(text, "reward", variables, values)
    return found.program, values
