"""`porse export`: the policy that a run ended with as one file that needs no PoRSE: ONNX, or TorchScript.

The networks are written by rsl-rl's own exporters. Observation statistics and clipping are inside: the file takes
observations as the task gives them, and returns the mean action, cut off at [-1, 1] as the task does.
"""

import warnings
from pathlib import Path

import click

from porse import numerics
from porse.config import TrainParams, load_params, presets_root
from porse.errors import PorseError
from porse.paths import check_target
from porse.printing import echo
from porse.renderer import import_without_drawing
from porse.report.results import params_file, winners_policy

OPSET = 18
"""Of ONNX: what rsl-rl writes."""

SUFFIXES = {"onnx": ".onnx", "torchscript": ".pt"}


@click.command()
@click.argument("run", type=click.Path(exists=True, path_type=Path))
@click.option("--onnx", is_flag=True, help="Write ONNX, input `obs`, output `actions`.")
@click.option("--torchscript", is_flag=True, help="Write TorchScript.")
@click.option(
    "--params",
    "path",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The run's parameters. [default: params.yaml in or above RUN]",
)
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="[default: TASK.onnx or TASK.pt]")
def export(run: Path, onnx: bool, torchscript: bool, path: Path | None, out: Path | None) -> None:
    """Write the policy of RUN's winner as ONNX or TorchScript, for use elsewhere.

    RUN is the folder of a run, or a policy or checkpoint of it (.safetensors).
    """
    if onnx == torchscript:
        found = "both" if onnx else "neither"
        raise click.UsageError(f"expected --onnx or --torchscript, found {found}; name one of them")
    form = "onnx" if onnx else "torchscript"
    where = path or params_file(run)
    params = load_params(where, presets_root(where.parent))
    target = out or Path(f"{params.task.replace(':', '.')}{SUFFIXES[form]}")
    check_target(target, (SUFFIXES[form],))
    policy = winners_policy(run, params) if run.is_dir() else run
    numerics.apply(params.numerics)
    import_without_drawing()
    write_policy(target, form, params.task, policy, params.train)
    echo(f"{target}: the policy of {policy}, {target.stat().st_size / 1024:.0f} KiB")


def write_policy(target: Path, form: str, task: str, policy: Path, params: TrainParams) -> None:
    """Writes the policy in a file as `form`, "onnx" or "torchscript".

    Raises:
        CheckpointError: the policy's file is missing, damaged, or of other networks.
        PorseError: what writes ONNX is not installed.
    """
    # Imported here: torch takes seconds.
    import torch

    from porse.checkpoint import read_checkpoint
    from porse.tasks import make_task
    from porse.training.ppo import build_ppo
    from porse.training.snapshot import load_policy
    from porse.training.vecenv import observation_groups

    class Clipped(torch.nn.Module):
        """What rsl-rl exports, with the clipping that the task does."""

        def __init__(self, network: torch.nn.Module) -> None:
            super().__init__()
            self.network = network

        def forward(self, obs: torch.Tensor) -> torch.Tensor:
            """Returns mean actions (samples, actions) in [-1, 1]."""
            return torch.clamp(self.network(obs), -1.0, 1.0)

    shown = make_task(task, 1, 0)
    ppo = build_ppo(observation_groups(shown.observations()), shown.NUM_ACTIONS, params)
    load_policy(ppo, read_checkpoint(policy), shown.NAME, policy)
    ppo.eval_mode()
    ppo.actor.requires_grad_(False)
    with warnings.catch_warnings():
        # The exporters are those of the pinned torch; what a later one will call otherwise is no news to a user.
        warnings.simplefilter("ignore")
        if form == "torchscript":
            torch.jit.script(Clipped(ppo.actor.as_jit()).eval()).save(str(target))
            return
        exported = ppo.actor.as_onnx(verbose=False)
        inputs, outputs = exported.input_names, exported.output_names
        try:
            torch.onnx.export(
                Clipped(exported).eval(),
                exported.get_dummy_inputs(),
                str(target),
                opset_version=OPSET,
                input_names=inputs,
                output_names=outputs,
                dynamic_axes={inputs[0]: {0: "samples"}, outputs[0]: {0: "samples"}},
                dynamo=False,
            )
        except (ImportError, torch.onnx.OnnxExporterError) as error:
            raise PorseError(
                f"expected what writes ONNX, found that it does not work here ({error}); run `pip install onnx`, or write "
                "--torchscript"
            ) from error
