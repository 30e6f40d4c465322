"""Models of intents by folder or by name, as the command line takes them."""

from __future__ import annotations

from pathlib import Path

from jink.estimators.sensor import Sensor
from jink.estimators.sensors import position
from jink.estimators.tracks import Tracks
from jink.intent.located import noise_sigma
from jink.intent.model import IntentModel
from jink.intent.model_file import MODEL_FILE, load_model
from jink.intent.pretrained import load_pretrained, pretrained_names

__all__ = ["find_model", "sensor_for"]


def find_model(text: str | Path, option: str = "--model", axes: int | None = None) -> IntentModel:
    """The model in a folder, or the one of that name that ships with the package; a folder wins.

    Args:
        text: folder or name.
        option: of the command line that gave it.
        axes: of the tracks it is for; None: any.

    Raises:
        ValueError: neither a folder nor a name, a file that is refused, or a model of other axes.
    """
    folder, names = Path(text), pretrained_names()
    if folder.is_dir() or folder.name == MODEL_FILE:
        try:
            model = load_model(folder)
        except (ValueError, FileNotFoundError) as error:
            said = str(error).removeprefix("load_model: ")
            raise ValueError(f"{option}: {said}") from error
    elif str(text) in names:
        model = load_pretrained(str(text))
    else:
        raise ValueError(
            f"{option}: value must be a folder that jink train intents wrote, or one of {', '.join(names)}; "
            f"got '{text}'. See jink list."
        )
    if axes is not None and model.axes != axes:
        raise ValueError(
            f"{option}: model must have the {axes} axes of the tracks; got one of {model.axes}. "
            f"Use --axes {model.axes}, or another model."
        )
    return model


def sensor_for(model: IntentModel, tracks: Tracks) -> tuple[Sensor, bool]:
    """A position sensor for tracks, and whether their own covariances are used.

    The tracks' own noise comes first, then what the model learned, then an estimate from the tracks.
    """
    if tracks.noise is not None:
        return position(tracks.axes, 1.0), True
    sigma = model.noise_sd if model.noise_sd is not None else tuple(noise_sigma(tracks).tolist())
    return position(tracks.axes, sigma), False
