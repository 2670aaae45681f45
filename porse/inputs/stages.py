"""What each stage reads: the sections of the parameters, and files besides the modules that it imports."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """One kind of stage.

    Attributes:
        script: the module that DVC runs.
        parameters: names of what it reads in the resolved `params.yaml`: `task`, `train`, `candidate.goal`.
        folders: files, and folders of files, that it reads as they are.
    """

    script: str
    parameters: tuple[str, ...]
    folders: tuple[str, ...] = ()


PACKAGES = "requirements.lock"
"""The pinned packages, which every result depends on."""

_ALL = ("numerics",)
_TRAINS = ("device", "deterministic")
_ASKED = ("prompts", "llm_cache/refreshed.txt")
"""Records are found by their question and written once, so they are not inputs; the list of those that were replaced is."""
_ASKS = ("task", "seed", "generator", "llm", "candidate", "generate")

STAGES: dict[str, Stage] = {
    "begin": Stage("stages.begin", (*_ALL, "task", "seed", "train")),
    "generate": Stage("stages.generate", (*_ALL, *_ASKS, "islands"), _ASKED),
    "validate-code": Stage(
        "stages.validate_code", (*_ALL, *_TRAINS, *_ASKS, "islands", "validate", "probe"), _ASKED
    ),
    "train-population": Stage(
        "stages.train_population",
        (*_ALL, *_TRAINS, "task", "seed", "candidate.goal", "candidate.bonus", "candidate.scale", "exploration", "train", "probe",
         "iterations", "generate.candidates"),
    ),
    "eliminate": Stage("stages.eliminate", (*_ALL, "eliminate")),
    "mutate": Stage("stages.mutate", (*_ALL, *_ASKS, "eliminate", "mutate", "fuse"), _ASKED),
    "fuse": Stage(
        "stages.fuse",
        (*_ALL, "task", "seed", "candidate", "generate", "islands", "train", "eliminate", "fuse",
         "iterations"),
    ),
    "evaluate": Stage(
        "stages.evaluate",
        (*_ALL, *_TRAINS, "task", "seed", "candidate", "exploration", "train", "fuse", "evaluate", "iterations", "rungs",
         "generate.candidates"),
    ),
    "summarise": Stage(
        "stages.summarise",
        (*_ALL, "task", "method", "ablation", "seed", "candidate", "generate", "islands", "train", "probe", "eliminate",
         "mutate", "fuse", "summarise", "iterations", "rungs"),
    ),
}  # fmt: skip
"""The stages that have inputs, by the name that `dvc.yaml` gives them, without the rung."""

NO_RESULT: dict[str, str] = {
    "porse/__init__.py": "a sentence and the version",
    "porse/config.py": "how parameters are read; their values are inputs",
    "porse/conversion.py": "how parameters are read; their values are inputs",
    "porse/documents.py": "how parameters are read; their values are inputs",
    "porse/methods/__init__.py": "how parameters are read; their values are inputs",
    "porse/methods/sets.py": "how parameters are read; of all sets, the values of the chosen ones are inputs",
    "porse/errors.py": "the words of an error change no result",
    "porse/inputs/__init__.py": "a sentence",
    "porse/inputs/files.py": "what the files are is an input, how they are found is not",
    "porse/inputs/imports.py": "what the files are is an input, how they are found is not",
    "porse/inputs/resolve.py": "what the files are is an input, how they are found is not",
    "porse/inputs/stages.py": "what the files are is an input, how they are found is not",
    "porse/paths.py": "where the package and the project lie",
    "porse/presets/__init__.py": "how parameters are read; their values are inputs",
    "porse/presets/own.py": "how parameters are read; their values are inputs",
    "porse/presets/rules.py": "how parameters are read; their values are inputs",
    "porse/printing.py": "what people see",
    "porse/processes.py": "who ends when",
    "porse/stage.py": "the command line of a stage",
    "porse/task_names.py": "the module that the run's task names is an input",
    "porse/training/bar.py": "what a terminal shows",
    "porse/training/cluster.py": "on which machine a training runs",
    "porse/training/remote.py": "on which machine a training runs",
    "porse/warm/__init__.py": "a sentence",
    "porse/warm/client.py": "which process does a stage's work",
    "stages/__init__.py": "who ends when",
}
"""Modules that stages import and that change no result, with the reason: changing them runs no stage again."""
