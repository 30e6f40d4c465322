"""Where the learner may compute: the processor, or a GPU that this torch can use."""

from __future__ import annotations

__all__ = ["check_device"]


def check_device(device: str) -> None:
    """Refuse a device that torch cannot compute on here; the processor needs no torch to be looked at.

    Args:
        device: "cpu", "cuda" or "cuda:N".

    Raises:
        ValueError: an unknown name, or no such device here.
        ModuleNotFoundError: a GPU is asked for and torch is not installed.
    """
    kind, _, number = device.partition(":")
    if kind not in ("cpu", "cuda") or (number and not number.isdecimal()):
        raise ValueError(f"IntentLearner: device must be cpu or cuda; got '{device}'. Leave it out for the processor.")
    if kind == "cpu":
        return
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if count == 0:
        raise ValueError(
            f"IntentLearner: device must be cpu where there is no GPU or no torch built for it; got '{device}'. Leave "
            "it out to train on the processor, or install torch for CUDA."
        )
    if int(number or 0) >= count:
        raise ValueError(
            f"IntentLearner: device must have a number below {count}, the GPUs here; got '{device}'. Use cuda."
        )
