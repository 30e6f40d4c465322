"""Where a training of an agent stands, as safetensors and JSON: nothing in it is ever executed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from jink.estimators.agent.policy_file import replace_file

__all__ = ["load_checkpoint", "save_checkpoint"]

STATE = "state.json"
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(folder: Path, model: Any, progress: dict[str, Any]) -> None:
    """Write weights, optimiser, counters and (of an off-policy model) the replay buffer; whole or not at all.

    Args:
        folder: made where it does not exist.
        model: of stable-baselines3.
        progress: JSON that comes back from `load_checkpoint`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {f"policy/{name}": value for name, value in model.policy.state_dict().items()}
    optimizer = model.policy.optimizer.state_dict()
    for number, slots in optimizer["state"].items():
        for name, value in slots.items():
            tensors[f"optimizer/{number}/{name}"] = torch.as_tensor(value)
    counters = {"num_timesteps": int(model.num_timesteps), "_n_updates": int(model._n_updates)}
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        counters |= {"pos": int(buffer.pos), "full": bool(buffer.full), "_n_calls": int(model._n_calls)}
        rows = buffer.buffer_size if buffer.full else buffer.pos
        for name in _BUFFER:
            tensors[f"buffer/{name}"] = torch.as_tensor(getattr(buffer, name)[:rows])
    name = f"model-{progress['round']}.safetensors"
    data = save_tensors({key: value.contiguous().clone() for key, value in tensors.items()})
    replace_file(folder / name, data)
    whole = {"tensors": name, "sha256": hashlib.sha256(data).hexdigest(), "counters": counters, "progress": progress}
    text = json.dumps({**whole, "check": _digest(whole)})
    replace_file(folder / STATE, text.encode())
    for old in folder.glob("model-*.safetensors"):
        if old.name != name:
            old.unlink(missing_ok=True)


def load_checkpoint(folder: Path, model: Any) -> dict[str, Any] | None:
    """Bring a freshly made model to where the last checkpoint was; its progress, or None where there is none.

    Raises:
        ValueError: tensors of another model, a file that is damaged or not there.
    """
    if not (folder / STATE).is_file():
        return None
    found = _read_state(folder / STATE)
    tensors = _read_tensors(folder / Path(found["tensors"]).name, found["sha256"])
    parts: dict[str, dict[str, torch.Tensor]] = {"policy": {}, "optimizer": {}, "buffer": {}}
    for key, value in tensors.items():
        kind, _, name = key.partition("/")
        parts[kind][name] = value
    wanted = model.policy.state_dict()
    if {name: value.shape for name, value in wanted.items()} != {n: v.shape for n, v in parts["policy"].items()}:
        raise ValueError("train agent: checkpoint must be of the same network; got another. Add --fresh.")
    model.policy.load_state_dict(parts["policy"])
    optimizer = model.policy.optimizer.state_dict()
    optimizer["state"] = {}
    for key, value in parts["optimizer"].items():
        number, _, name = key.partition("/")
        optimizer["state"].setdefault(int(number), {})[name] = value
    model.policy.optimizer.load_state_dict(optimizer)
    counters = found["counters"]
    model.num_timesteps, model._n_updates = counters["num_timesteps"], counters["_n_updates"]
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        buffer.pos, buffer.full, model._n_calls = counters["pos"], counters["full"], counters["_n_calls"]
        for name, value in parts["buffer"].items():
            getattr(buffer, name)[: len(value)] = np.asarray(value)
    return dict(found["progress"])


def _digest(state: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(state, sort_keys=True).encode()).hexdigest()


def _read_state(path: Path) -> dict[str, Any]:
    """The state, if it is as it was written."""
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, OSError):
        raise _damaged(path) from None
    if not isinstance(found, dict) or found.pop("check", None) != _digest(found):
        raise _damaged(path)
    return found


def _read_tensors(path: Path, sha256: str) -> dict[str, torch.Tensor]:
    """The tensors, if they are as they were written."""
    try:
        data = path.read_bytes()
    except OSError:
        raise _damaged(path, "which is not there") from None
    if hashlib.sha256(data).hexdigest() != sha256:
        raise _damaged(path)
    return dict(load_tensors(data))


def _damaged(path: Path, what: str = "which is damaged") -> ValueError:
    return ValueError(f"train agent: checkpoint must be whole; got {path}, {what}. Add --fresh to begin anew.")
