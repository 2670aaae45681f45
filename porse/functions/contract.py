"""The contract of generated code, as data: what the checker enforces, and `prompts/contract.jinja` tells a model."""

from porse.functions.verdict import TENSOR_FUNCTIONS, Kind, words

FUNCTION_NAMES: dict[Kind, tuple[str, ...]] = {
    "reward": ("compute_reward", "reward_function", "compute_reward_function", "reward", "get_reward"),
    "mapping": ("mapping_function", "compute_mapping", "mapping", "progress_function", "compute_progress"),
}
"""Names under which a function is looked for, the first is the one that prompts ask for."""

NAME_PATTERN: dict[Kind, str] = {
    "reward": r"(compute|calculate|get)_\w*reward\w*",
    "mapping": r"\w*(mapping|progress)_\w+",
}
"""Names that are accepted when none of `FUNCTION_NAMES` is there."""

HELPERS: dict[str, str] = {
    "dist": "dist(a, b): Euclidean distance along the last dimension, (num_envs,) for two (num_envs, 3) positions",
    "rot_dist": "rot_dist(q1, q2): angle in radians between two rotations given as quaternions xyzw, (num_envs,)",
}
"""Helpers that exist without being defined, with the line that prompts print."""

ROOT_INDICES = words("object_indices object_another_indices block_indices")
"""Variables that say which column of `root_state_tensor` (num_envs, actors, 13) an actor has.

The original's roots are one array of all environments' actors, and its code reads `root_state_tensor[object_indices, 0:3]`.
Such an index in the first place means that column in every environment: as if `[:, object_indices, 0:3]` were written.
"""

MAX_REPLY_CHARACTERS = 200_000
MAX_SOURCE_LINES = 600
MAX_TREE_NODES = 20_000
MAX_TREE_DEPTH = 60
MAX_INTEGER = 10_000_000
"""Largest integer literal."""
MAX_LOOP = 1_000
"""Largest count of a `range`, or of a repeated list, that is written as a number."""

BUILTINS = words(
    "abs all any bool dict enumerate filter float int isinstance len list map max min pow print range reversed round set sorted "
    "str sum tuple zip"
)

ERRORS = words("Exception ArithmeticError AssertionError IndexError KeyError RuntimeError TypeError ValueError")
"""What may be raised, with a text."""

TORCH_CONSTANTS = words(
    "pi e inf nan float float32 float64 double int int32 int64 long bool uint8 half float16 Tensor FloatTensor"
)

TORCH_FUNCTIONS = TENSOR_FUNCTIONS | words("""
    arange as_tensor atleast_1d broadcast_tensors cat cdist column_stack concat concatenate cosine_similarity einsum
    eye full full_like hstack linspace numel ones ones_like stack std_mean tensor var_mean vstack zeros zeros_like
    """)

TORCH_MODULES: dict[str, frozenset[str]] = {
    "linalg": words("cross multi_dot norm vecdot vector_norm"),
    "special": words("erf exp2 expit expm1 log1p logit logsumexp sinc softmax xlogy"),
    "nn.functional": words("""
        celu cosine_similarity elu gelu hardsigmoid hardtanh huber_loss l1_loss leaky_relu log_softmax logsigmoid mish
        mse_loss normalize pairwise_distance relu relu6 selu sigmoid silu smooth_l1_loss softmax softmin softplus softsign tanh
        threshold
        """),
    "jit": words("annotate"),
}

_OF_NUMPY = words("cos cosh degrees e exp inf log log10 log1p nan pi radians sin sinh sqrt tan tanh")
MATH_NAMES = _OF_NUMPY | words("acos asin atan atan2 ceil fabs floor isfinite isinf isnan pow tau")

NUMPY_NAMES: dict[str, str] = {name: f"math.{name}" for name in _OF_NUMPY} | {
    "abs": "abs", "absolute": "abs", "arccos": "math.acos", "arcsin": "math.asin", "arctan": "math.atan",
    "arctan2": "math.atan2", "deg2rad": "math.radians", "power": "math.pow", "rad2deg": "math.degrees",
}  # fmt: skip
"""What of numpy may be used, with what it is written as: functions of numbers, of which most take tensors as well."""

METHODS = TENSOR_FUNCTIONS | words("""
    add_ bool clamp_ clamp_max_ clamp_min_ contiguous copy_ detach dim div_ double expand expand_as fill_ float half
    int item long masked_fill_ mul_ neg_ new_full new_ones new_tensor new_zeros numel pow_ repeat reshape_as size
    sub_ to type type_as view view_as zero_
    append copy count endswith extend format get index insert items join keys lower pop replace reverse setdefault
    startswith strip update upper values
    """)
"""Methods of tensors, lists, dictionaries and strings."""

ATTRIBUTES = words("T mT device dtype ndim requires_grad shape values indices")

MODULES = words("""
    torch math typing numpy __future__ abc collections dataclasses enum functools gym gymnasium isaacgym isaacgymenvs
    omniisaacgymenvs bidexhands utils
    """)
"""Modules whose import lines are accepted. No import is ever executed; names come only from torch, math and numpy."""
