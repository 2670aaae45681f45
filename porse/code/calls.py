"""Calls that TorchScript does not know in the form in which they are usually written, in a form that it knows."""

import re

FUNCTIONAL = "porse_functional"
"""Name of torch.nn.functional in the text that is compiled: F is a good name for a force."""

_CONSTRUCTORS = ("torch.Tensor", "torch.FloatTensor")
_WITH_ORDER = {f"{FUNCTIONAL}.normalize": ("functional_normalize", 1), "torch.cdist": ("cdist", 2)}
"""Helpers of ours that take the order of a norm, which is a float there, and where it stands."""
_NORM_ORDERS = {'"fro"': "2", "None": "2", 'float("inf")': "math.inf"}


def plain_form(
    function: str, arguments: list[str], keywords: dict[str, str], is_list: bool
) -> tuple[str, list[str], str]:
    """Returns function and arguments of a call in plain form, and the helper of ours to call instead, "" for none.

    Args:
        function: what is called; a method that is written anew comes as the function of torch.
        arguments: texts of the arguments.
        keywords: texts of the keyword arguments; changed where the form asks for it.
        is_list: whether the only argument is a list or a tuple that is written out.
    """
    if function == "torch.norm":
        return _norm(arguments, keywords)
    if function in _WITH_ORDER:
        helper, position = _WITH_ORDER[function]
        if "p" in keywords:
            keywords["p"] = f"float({keywords['p']})"
        arguments[position : position + 1] = [f"float({order})" for order in arguments[position : position + 1]]
        return function, arguments, helper
    if function == "torch.cross":
        # Without a dimension torch.cross takes the first of size 3: the wrong one for three environments.
        if len(arguments) > 2:
            keywords["dim"] = arguments.pop(2)
        return "torch.linalg.cross", arguments, ""
    if function in ("torch.type", "torch.bool") and arguments:
        return f"{arguments[0]}.to", arguments[1:] or ["torch.bool"], ""
    if function in _CONSTRUCTORS and is_list:
        keywords["dtype"] = "torch.float32"
        return "torch.tensor", arguments, ""
    if function == "sum" and len(arguments) == 1 and not keywords:
        return function, arguments, "sum"
    return function, arguments, ""


def _norm(arguments: list[str], keywords: dict[str, str]) -> tuple[str, list[str], str]:
    """Returns torch.norm as the operator that it comes to: its own source takes ten times as long to compile."""
    given = dict(zip(("input", "p", "dim", "keepdim"), arguments, strict=False)) | keywords
    order = _NORM_ORDERS.get(given.get("p", '"fro"'), given.get("p", ""))
    if given.keys() - {"input", "p", "dim", "keepdim"} or not re.fullmatch(r"-?[\d.]+|math\.inf", order):
        return "torch.norm", arguments, ""
    keywords.clear()
    plain = [given["input"], order, given.get("dim", "None"), given.get("keepdim", "False")]
    return "torch.linalg.vector_norm", plain, ""
