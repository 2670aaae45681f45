"""Hostile replies, by name. CANARY stands for a file that must not come to exist or be read."""
# ruff: noqa: RUF001 (look-alikes are the point)

_HEAD = "def compute_reward(a, b):\n    x = a[:, 0] + b[:, 0]\n"
_TAIL = '    return x, {"x": x}\n'


def _body(*lines: str) -> str:
    return _HEAD + "".join(f"    {line}\n" for text in lines for line in text.split("\n")) + _TAIL


def _around(*lines: str) -> str:
    return "\n".join(lines) + "\n" + _body()


def _made_of(arguments: str, *lines: str) -> str:
    body = "".join(f"        {line}\n" for line in lines)
    return f"class R:\n    def __init__(self, {arguments}):\n{body}\n" + _body("r = R()", "x = x * r.x")


ATTACKS: dict[str, str] = {
    # Files and the outside.
    "open_read": _body('y = open("CANARY").read()'),
    "open_write": _body('open("CANARY", "w").write("x")'),
    "torch_save": _body('torch.save(x, "CANARY")'),
    "torch_load": _body('y = torch.load("CANARY")'),
    "torch_from_file": _body('y = torch.from_file("CANARY", shared=True, size=100)'),
    "torch_jit_load": _body('y = torch.jit.load("CANARY")'),
    "torch_ops": _body('y = torch.ops.aten.from_file("CANARY", True, 100)'),
    "torch_ops_library": _body('torch.ops.load_library("CANARY")'),
    "torch_classes": _body('torch.classes.load_library("CANARY")'),
    "torch_hub": _body('torch.hub.load("CANARY", "x")'),
    "torch_c": _body("torch._C._jit_set_profiling_mode(True)"),
    "torch_cpp_extension": _body('torch.utils.cpp_extension.load(name="x", sources=["CANARY"])'),
    "numpy_tofile": _body('x.numpy().tofile("CANARY")'),
    "numpy_save": _body('np.save("CANARY", x)'),
    "storage": _body("y = x.untyped_storage().data_ptr()"),
    "hook": _body("x.register_hook(print)"),
    # Python itself.
    "import_top": _around("import os", 'os.system("touch CANARY")'),
    "import_top_unused": _around("import subprocess"),
    "import_inside": _body("import os", 'os.system("touch CANARY")'),
    "import_from": _body("from os import system", 'system("touch CANARY")'),
    "import_alias": _body("import torch as math", 'math.save(x, "CANARY")'),
    "import_renamed": _body("from torch import save as exp", 'exp(x, "CANARY")'),
    "dunder_import": _body('__import__("os").system("touch CANARY")'),
    "exec": _body("exec(\"open('CANARY', 'w')\")"),
    "eval": _body("y = eval(\"open('CANARY', 'w')\")"),
    "compile": _body('y = compile("1", "CANARY", "exec")'),
    "getattr": _body('getattr(torch, "save")(x, "CANARY")'),
    "globals": _body('globals()["__builtins__"]["open"]("CANARY", "w")'),
    "builtins": _body('__builtins__.open("CANARY", "w")'),
    "dunder_walk": _body("y = ().__class__.__bases__[0].__subclasses__()"),
    "dunder_of_tensor": _body("y = x.__class__.__init__.__globals__"),
    "dunder_of_module": _body("y = torch.__dict__"),
    "underscore_of_torch": _body("y = torch._utils"),
    "top_level_call": _around('torch.save(torch.zeros(1), "CANARY")'),
    "top_level_exec": _around("exec(\"open('CANARY', 'w')\")"),
    # Places where Python evaluates before it runs.
    "decorator": '@open("CANARY", "w").write\n' + _body(),
    "decorator_of_helper": '@open("CANARY", "w").write\ndef h(y):\n    return y\n' + _body("x = h(x)"),
    "decorator_inside": _body('@open("CANARY", "w").write\ndef h(y):\n    return y', "x = h(x)"),
    "default_argument": _body().replace("(a, b)", '(a, b, t=open("CANARY", "w"))'),
    "default_of_helper": 'def h(y, t=open("CANARY", "w")):\n    return y\n' + _body("x = h(x)"),
    "default_of_lambda": _body('h = lambda y, t=open("CANARY", "w"): y', "x = h(x)"),
    "annotation": _body().replace("(a, b)", '(a: open("CANARY", "w"), b)'),
    "annotation_of_result": _body().replace("(a, b)", '(a, b) -> open("CANARY", "w")'),
    "annotation_as_text": _body().replace("(a, b)", "(a: \"open('CANARY', 'w')\", b)"),
    "annotation_of_local": _body('y: open("CANARY", "w") = 1.0'),
    "constant": _around('T = open("CANARY", "w")').replace("a[:, 0] +", "T * a[:, 0] +"),
    "constant_of_lines": _around("T = [", '    open("CANARY", "w"),', "]").replace("a[:, 0] +", "T[0] * a[:, 0] +"),
    "constant_tensor": _around('T = torch.tensor(open("CANARY", "w"))').replace("a[:, 0] +", "T * a[:, 0] +"),
    "statement_of_lines": _around("open(", '    "CANARY", "w"', ")"),
    "class_body": "class R:\n    y = open('CANARY', 'w')\n" + "".join(f"    {line}\n" for line in _body().splitlines()),
    "inner_class": _body("class R:\n    y = open('CANARY', 'w')"),
    "docstring_goes_on": _body('"""Text.""" + open("CANARY", "w").read()'),
    "fstring": _body("y = f\"{open('CANARY', 'w')}\""),
    "fstring_format": _body("y = f\"{x:{open('CANARY', 'w')}}\""),
    "format_dunder": _body('y = "{0.__class__.__init__.__globals__}".format(x)'),
    "percent": _body('y = "%s" % x'),
    "print": _body('print(open("CANARY", "w"))'),
    "assert": _body('assert open("CANARY", "w")'),
    "walrus": _body('y = (z := open("CANARY", "w"))'),
    "comprehension": _body('y = [open("CANARY", "w") for i in range(3)]'),
    "with": _body('with open("CANARY", "w") as f:\n    y = 1'),
    "star": _body('y = torch.cat(*[open("CANARY", "w")])'),
    "double_star": _body('y = torch.zeros(3, **{"out": x})'),
    "yield": _body("yield x"),
    "async": _body().replace("def", "async def"),
    "global": _body("global torch", "torch = 1.0"),
    "shadow_torch": _body("torch = x"),
    "reserved_prefix": _body("porse_f_compute_reward = x"),
    "raise": _body("raise SystemExit"),
    "raise_with_call": _body('if a.shape[0] < 0:\n    raise ValueError(open("CANARY", "w"))'),
    "raise_of_another": _body("raise os.abort()"),
    "other_name_for_save": _body("keep = torch.save", 'keep(x, "CANARY")'),
    "other_name_for_open": _body("keep = open", 'keep("CANARY", "w")'),
    "other_name_for_import": _body("load = __import__", 'load("os")'),
    "condition_in_comprehension": _body('y = [i for i in range(3) if open("CANARY", "w")]'),
    "star_of_open": _body('y, z = zip(*open("CANARY", "w"))'),
    "star_of_a_call": _body('y = torch.zeros(*open("CANARY", "w"))'),
    "constant_from_constant": _around("S = 1.0", 'T = S * len(open("CANARY", "w").read())').replace(
        "a[:, 0] +", "T * a[:, 0] +"
    ),
    "constant_calls_torch": _around("T = torch.hub.list('CANARY')").replace("a[:, 0] +", "T[0] * a[:, 0] +"),
    "method_of_text": _body('y = "CANARY".encode()'),
    "inner_function_that_opens": _body('def add(name):\n    open(name, "w")', 'add("CANARY")'),
    "set_attribute": _body("x.data = a"),
    "set_self": _body("self.root = x").replace("(a, b)", "(self, a, b)"),
    "delete_attribute": _body("del x.data"),
    "state_of_torch": _body("torch.set_num_threads(64)"),
    "seed_of_torch": _body("torch.manual_seed(1)"),
    "random_numbers": _body("x = x + torch.rand(x.shape[0])"),
    # Names that look like others.
    "full_width": _body("ｏｐｅｎ('CANARY', 'w')"),
    "cyrillic": _body("y = tоrch.exp(x)"),
    "mathematical_letters": _body("y = torch.𝓼𝓪𝓿𝓮(x, 'CANARY')"),
    "right_to_left": _body("y = 1.0  # \u202e )'w' ,'CANARY'(nepo"),
    "null_character": _body("y = 1.0\0"),
    # Time, memory, size.
    "while": _body("while True:\n    x = x + 1"),
    "long_loop": _body("for i in range(1000000000):\n    x = x + 1"),
    "deep_loops": _body(
        "for i in range(900):\n    for j in range(900):\n        for k in range(900):\n            x = x + 1"
    ),
    "loop_over_data": _body("for i in range(int(x.sum() * 1e9)):\n    x = x + 1"),
    "recursion": _body().replace("a[:, 0] +", "compute_reward(a, b)[0] +"),
    "recursion_of_helpers": "def g(y):\n    return h(y)\ndef h(y):\n    return g(y)\n" + _body("x = h(x)"),
    "doubling": _body("for i in range(60):\n    x = torch.cat([x, x])"),
    "doubling_when_far": _body("if x.mean() > 1e6:\n    for i in range(60):\n        x = torch.cat([x, x])"),
    "doubling_in_large_runs": _body("if a.shape[0] > 3000:\n    for i in range(60):\n        x = torch.cat([x, x])"),
    "doubling_text": _body('s = "ab"', "for i in range(60):\n    s = s + s"),
    "doubling_list": _body("y = [x]", "for i in range(60):\n    for z in y:\n        y.append(z)", "x = x + len(y)"),
    "doubling_list_by_addition": _body("y = [x]", "for i in range(60):\n    y = y + y", "x = x + len(y)"),
    "doubling_list_in_place": _body("y = [x]", "for i in range(60):\n    y += y", "x = x + len(y)"),
    "doubling_list_when_far": _body(
        "y = [x]", "for i in range(60):\n    if x.mean() > 1e6:\n        y = y + y", "x = x + len(y)"
    ),
    "list_of_lists": _body("y = [0.0] * 10000000", "z = [y] * 10000000 + [y] * 10000000", "x = x + len(z)"),
    "size_grown_when_far": _body(
        "n = 1", "for i in range(9):\n    if x.mean() > 1e6:\n        n = n * 10", "x = x + torch.zeros(n).sum()"
    ),
    "size_grown_until_far": _body(
        "n = 1",
        "for i in range(9):\n    if x.mean() < 1e6:\n        break\n    n = n * 10",
        "x = x + torch.zeros(n).sum()",
    ),
    "rounds_grown_when_far": _body(
        "n = 1",
        "for i in range(9):\n    if x.mean() > 1e6:\n        n = n * 10",
        "for i in range(n):\n    x = x + 1.0",
    ),
    "size_carried_through_a_loop": _body(
        "n = 1", "for i in range(3):\n    n = int(x.sum() * 1e12)\n    x = x + 1", "x = x + torch.zeros(n).sum()"
    ),
    "huge_tensor": _body("y = torch.zeros(1000000, 1000000)", "x = x + y.sum()"),
    "huge_range": _body("y = torch.arange(100000000000)", "x = x + y.sum()"),
    "huge_repeat": _body("y = x.repeat(1000000, 1000)", "x = x + y.sum()"),
    "size_from_data": _body("y = torch.zeros(int(x.abs().sum() * 1e12))", "x = x + y.sum()"),
    "size_from_item": _body("y = torch.zeros(int(x.sum().item()) + 1000)", "x = x + y.sum()"),
    "range_from_data": _body("y = torch.arange(float(x.abs().sum()) * 1e12)", "x = x + y.sum()"),
    "huge_list": _body("y = [0] * 10000000000"),
    "huge_integer": _body(f"y = {'9' * 5000}"),
    "power_tower": _body("y = 9 ** 9 ** 9 ** 9", "x = x * y"),
    "deep_brackets": _body(f"y = {'(' * 500}1{')' * 500}"),
    "deep_minus": _body(f"y = {'-' * 5000}1"),
    "long_reply": "# filler\n" * 50_000 + _body(),
    # Classes that are made.
    "class_with_a_default": _made_of("x=open('CANARY', 'w').write('x')", "self.x = x"),
    "class_with_a_setting": _made_of("", "self.x = open('CANARY', 'w').write('x')"),
    "class_whose_parent_is_called": _made_of("", "super().__init__(open('CANARY', 'w'))", "self.x = 1"),
    "class_whose_parent_is_walked": _made_of("", "self.x = super().__init__.__globals__"),
    "class_with_a_huge_default": _made_of("x=[0] * 10000000000", "self.x = x[0]"),
    "numpy_load": _body('y = np.load("CANARY")'),
    "numpy_fromfile": _body('y = np.exp(np.fromfile("CANARY"))'),
    # The task's own state.
    "write_input": _body("a[:, 0] = 1e9"),
    "write_input_through_view": _body("y = a.view(-1)", "y.fill_(0.0)"),
    "write_input_in_loop_that_may_not_run": _body(
        "y = a", "for i in range(a.shape[0] - 2048):\n    y = y + 1", "y[:] = 0.0"
    ),
    "write_input_from_dictionary": _body('d = {"a": a}', 'd["a"][:, 0] = 1e9'),
    "write_input_with_out": _body("y = torch.exp(b, out=a)"),
}

HARMLESS_LOOKALIKES: dict[str, str] = {
    "docstring_with_code": _HEAD.replace("\n", '\n    """\n    import os; os.system("touch CANARY")\n    """\n', 1)
    + _TAIL,
    "comment_with_code": _body('# open("CANARY", "w")'),
}
"""Text that is never run: accepted, and nothing of it takes effect."""

TRACER_ATTACKS: dict[str, str] = {
    # Objects that answer for themselves.
    "class_with_getattr": _body("class R:\n    def __getattr__(self, name):\n        return open", "y = R().x"),
    "class_with_format": _body(
        "class R:\n    def __format__(self, how):\n        return open('CANARY').read()", "y = f'{R()}'"
    ),
    "class_that_is_a_tensor": _body("class R(torch.Tensor):\n    pass", "x = R(x)"),
    "class_made_by_type": _body("R = type('R', (), {'x': 1})", "x = x * R().x"),
    "torch_function": _body("y = x.__torch_function__"),
    "torch_dispatch": _body("def __torch_dispatch__(f, t, a, k):\n    return a", "x = x + 1"),
    "descriptor": _body("class D:\n    def __get__(self, o, t):\n        return open", "y = D()"),
    "property": _body("y = property(lambda self: open)"),
    "mode_of_torch": _body("with torch.utils._python_dispatch._disable_current_modes():\n    x = x + 1"),
    "no_dispatch": _body("y = torch._C._DisableTorchDispatch()"),
    # Generators, frames, exceptions.
    "generator_frame": _body("g = (i for i in range(3))", "y = g.gi_frame.f_back.f_builtins"),
    # A name of the source's own is an attribute of self alone, whatever else has one of that name.
    "frames_by_own_names": "def gi_frame():\n    return 0\n\ndef f_back():\n    return 0\n\ndef f_builtins():\n    return 0\n\n"
    + _body(
        "box = [0]",
        "g = (box[0].gi_frame.f_back for i in range(1))",
        "box[0] = g",
        "list(g)[0].f_back.f_builtins['open']('CANARY', 'w')",
    ),
    "frames_by_own_constants": "gi_frame = 0\nf_back = 0\nf_builtins = 0\n"
    + _body("g = (i for i in range(3))", "y = g.gi_frame.f_back.f_builtins"),
    "a_self_that_is_none": "def gi_frame():\n    return 0\n\n"
    + _body("def look(self):\n    return self.gi_frame", "y = look(i for i in range(3))"),
    "a_module_that_is_none": "def gi_frame():\n    return 0\n\n" + _body("F = (i for i in range(3))", "y = F.gi_frame"),
    "typing_that_is_none": "from torch import jit\n\ndef gi_frame():\n    return 0\n\n"
    + _body("jit = (i for i in range(3))", "y = jit.gi_frame"),
    "list_of_a_tensor_by_own_name": "def tolist():\n    return 0\n\n" + _body("x = x * a.tolist()[0][0]"),
    "format_joined": _body('f = "{0._" + "_globals_" + "_}"', "y = {}[f.format(dist)]"),
    "format_index": _body('y = "{0[0]}".format([open])'),
    "format_joined_length": _body('f = "{0._" + "_globals_" + "_}"', "x = x * len(f.format(dist))"),
    # Where objects lie in memory.
    "address_by_str": _body("x = x * (int(str(torch.add)[-8:-1], 16) / 1e9)"),
    "address_by_mapped_str": _body("x = x * len([*map(str, [torch.add])][0])"),
    "address_by_f_string": _body('x = x * len(f"{torch.exp}")'),
    "address_by_percent": _body('x = x * len("%s" % torch.exp)'),
    "address_by_percent_in_place": _body('y = "%s"', "y %= torch.exp", "x = x * len(y)"),
    "address_by_format": _body('x = x * len("{}".format(torch.exp))'),
    "address_in_a_list": _body('x = x * len(f"{[dist]}")'),
    "address_of_an_iterator": _body('x = x * len(f"{zip([1], [2])}")'),
    "generator_function": _body("def g():\n    yield open", "y = [f for f in g()]"),
    "coroutine": _body("async def g():\n    return open", "y = g().cr_frame"),
    "exception_with_its_own_text": _body(
        "class E(ValueError):\n    def __str__(self):\n        return open('CANARY').read()", "raise E('x')"
    ),
    "exception_that_is_caught": _body("try:\n    y = float(x[0])\nexcept Exception as e:\n    y = e.__traceback__"),
    "exception_of_a_group": _body("try:\n    pass\nexcept* ValueError:\n    pass"),
    "raise_what_is_no_error": _body("raise KeyboardInterrupt('x')"),
    "function_globals": _body("def h():\n    pass", "y = h.__globals__"),
    "function_code": _body("def h():\n    pass", "h.__code__ = compute_reward.__code__"),
    "endless_recursion": _body("def h(n):\n    return h(n + 1)", "x = x + h(0)"),
    "recursion_through_a_list": _body("f = []", "f.append(lambda n: f[0](n + 1))", "x = x + f[0](0)"),
    # Torch changed for whoever comes after.
    "patch_torch": _body("torch.exp = torch.sin", "x = torch.exp(x)"),
    "patch_by_setattr": _body("setattr(torch, 'exp', torch.sin)", "x = torch.exp(x)"),
    "patch_tensor": _body("torch.Tensor.add = torch.Tensor.sub"),
    "patch_the_namespace": _body("y = getattr(self, 'exp')"),
    "default_type": _body("torch.set_default_dtype(torch.float64)"),
    "library_of_operators": _body("y = torch.library.Library('aten', 'IMPL')"),
    # Lists without a bound, and lists that differ.
    "graph_without_end": _body("for i in range(900):\n    for j in range(900):\n        x = x + 1.0"),
    "graph_of_ranges": _body("x = sum([x * i for i in range(900) for j in range(9)])"),
    "graph_of_a_string": _body("x = x + len('a' * 10000000000)"),
    "constant_without_end": _body("x = x + torch.tensor([[0.5] * 900] * 900).sum()"),
    "environments_one_by_one": _body("x = torch.stack([a[i, 0] for i in range(a.shape[0])])"),
    "a_count_of_calls": "CALLS = [0]\n" + _body("CALLS.append(1)", "x = x * len(CALLS)"),
    "a_tensor_of_calls": "CALLS = torch.zeros(1)\n" + _body("CALLS.add_(1.0)", "x = x * CALLS"),
    "a_default_of_calls": "def h(y, calls=[0, 0]):\n    calls.append(1)\n    return y * len(calls)\n"
    + _body("x = h(x)"),
    "a_branch_on_chance": _body("x = x * (2.0 if id(x) % 32 else 1.0)"),
    "a_branch_on_the_time": _body("import time", "x = x * time.time()"),
    "a_branch_on_many": _body("if a.shape[0] > 4000:\n    x = x * 0.0"),
    # Numbers taken out of tensors, and what traps.
    "item": _body("x = x * a.mean().item()"),
    "truth": _body("if (x > 0).all():\n    x = x * 2"),
    "text_of_a_tensor": _body("x = x * len(f'{a}')"),
    "rows_by_a_mask": _body("y = a[a[:, 0] > 0]", "x = x + (y[:, :1] * y[:, 0]).sum()"),
    "whole_numbers_that_trap": _body("i = (x * 0).long() - 2**30", "x = x + i // ((x * 0).long() - 1)"),
    "whole_numbers_that_trap_later": _body(
        "y = (x * 0 - 1e30).long()",
        "x = x + torch.div(y, num_envs - 129, rounding_mode='trunc').float()",
    ).replace("(a, b)", "(a, b, num_envs)"),
    "sizes_by_data": _body("k = (x > 5).sum() + 1", "x = x + torch.tensor_split(x, k)[0].sum()"),
    "whole_numbers_by_zero": _body("x = x + (x * 9).long() % (x * 0).long()"),
}
"""Attacks on the trace: on Python in the confined process, on what is written down, and on what it does when it is run."""
