"""Estimators of other people: one file, named on the command line as ``path/to/mine.py:make``."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from jink.estimators.api import BankEstimator
from jink.estimators.bank import Bank
from jink.estimators.recipes import RECIPES, Scales, make_estimator
from jink.estimators.sensor import Sensor
from jink.training.outside import OutsideEstimator, WholeTrack
from jink.training.rows import hash_files

__all__ = ["Maker", "is_spec", "load_maker", "make_from", "make_named", "said", "spec_digest", "spec_label"]

_SCALES = tuple(field.name for field in fields(Scales))
_OFFERED = ("sensor", "scales", *_SCALES)
_OURS = tuple(
    str(Path(place).resolve())
    for layer in ("estimators", "envs", "training")
    for place in importlib.import_module(f"jink.{layer}").__path__
)


class Maker(NamedTuple):
    """What a spec names: a class or function, where it lies, and what it is called in tables."""

    label: str
    make: Callable[..., Any]
    file: Path | None


def is_spec(name: str) -> bool:
    """Whether a name is ``file.py:make`` or ``package.module:make`` and no recipe's."""
    return name not in RECIPES and ":" in name


def spec_label(spec: str) -> str:
    """What tables call it: the file without its folders, and the name in it."""
    place, _, name = spec.rpartition(":")
    return f"{Path(place).name}:{name}"


def spec_digest(spec: str) -> str:
    """Short hash of the file behind a spec, so that results of an older version are not taken for the new one's."""
    file = load_maker(spec).file
    return "" if file is None else hash_files(file)


def make_named(name: str, sensor: Sensor, **options: Any) -> Any:
    """An estimator by a recipe's name or by ``path/to/mine.py:make``.

    Args:
        name: a recipe, or a spec (see `load_maker`).
        sensor: what is measured.
        options: as for `make_estimator`; a spec's function gets those scales that it asks for by name.

    Returns:
        a `BankEstimator`, or an `OutsideEstimator` with the same `run`, and `start` and `step` where it streams.

    Raises:
        ValueError: an unknown name, or what `load_maker` and the file's own function refuse.
    """
    if not is_spec(name):
        return make_estimator(name, sensor, **options)
    maker = load_maker(name)
    scales = Scales(**{key: value for key, value in options.items() if key in _SCALES})
    return make_from(maker, sensor, scales)


def make_from(maker: Maker, sensor: Sensor, scales: Scales) -> Any:
    """The estimator that a maker makes for a sensor.

    Raises:
        ValueError: a parameter that cannot be filled in, an exception in it, or something that is no estimator.
    """
    wanted = _parameters(maker)
    if "measurements" in wanted:
        return OutsideEstimator(WholeTrack(maker.make), sensor, maker.label)
    known = {"sensor": sensor, "scales": scales, **asdict(scales), "turn_rate": scales.turn}
    given = {key: known[key] for key, required in wanted.items() if key in known}
    unknown = [key for key, required in wanted.items() if required and key not in known]
    if unknown:
        raise ValueError(
            f"{maker.label}: parameters must be among {', '.join(_OFFERED)}; got {', '.join(unknown)}. "
            "Give other parameters a default."
        )
    try:
        made = maker.make(**given)
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"{maker.label}: call must give an estimator; got {said(error)}. Mend it, then jink check {maker.label}."
        ) from error
    if isinstance(made, Bank):
        made = BankEstimator(made, name=maker.label)
    if isinstance(made, BankEstimator):
        made.name = maker.label
        return made
    return OutsideEstimator(made, sensor, maker.label)


def load_maker(spec: str) -> Maker:
    """Find the class or function that a spec names.

    Args:
        spec: ``path/to/mine.py:make``, or ``package.module:make`` of something installed.

    Returns:
        the maker. It is called with those of sensor, scales, acceleration, speed, turn_rate, sojourn, surge_every,
        surge_for that its parameters name; a function with a parameter ``measurements`` is itself the estimator.

    Raises:
        ValueError: no such file, module or name, or an exception while importing it.
    """
    place, colon, name = spec.rpartition(":")
    if not (colon and place and name.isidentifier()):
        raise ValueError(
            f"--estimator: value must be a recipe or FILE.py:NAME; got '{spec}'. Write for example mine.py:make."
        )
    file = Path(place)
    if file.suffix == ".py":
        if not file.is_file():
            raise ValueError(f"--estimator: file must exist; got {place}. Name the file before the colon.")
        module = _from_file(file)
    elif "/" in place or "\\" in place or file.exists() or not all(part.isidentifier() for part in place.split(".")):
        raise ValueError(
            f"--estimator: file must end in .py; got {place}. Write for example mine.py:make, or package.module:make."
        )
    else:
        module = _installed(place)
        file = Path(module.__file__) if module.__file__ else file
    found = getattr(module, name, None)
    if not callable(found):
        own = [key for key, value in vars(module).items() if _is_own(module, key, value)]
        raise ValueError(
            f"--estimator: name must be a class or function of {Path(place).name}; got '{name}'. "
            f"There are {', '.join(own) or 'none'}."
        )
    return Maker(f"{file.name if Path(place).suffix == '.py' else place}:{name}", found, file)


def said(error: BaseException) -> str:
    """An exception in a few words: its kind, what it says, and the line of the user's file that raised it."""
    text = " ".join(str(error).split())
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _lies_in(f.filename, _OURS)]
    theirs = [f for f in frames if not _lies_in(f.filename, ("site-packages", "dist-packages"))] or frames
    place = f" ({Path(theirs[-1].filename).name}, line {theirs[-1].lineno})" if theirs else ""
    return f"{type(error).__name__}{f': {text}' if text else ''}{place}"


def _lies_in(file: str, folders: tuple[str, ...]) -> bool:
    return any(folder in (str(parent), parent.name) for parent in Path(file).resolve().parents for folder in folders)


def _parameters(maker: Maker) -> dict[str, bool]:
    """Name of each parameter -> whether it must be given."""
    try:
        found = inspect.signature(maker.make).parameters.values()
    except (TypeError, ValueError):
        return {}
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    single = [p for p in found if p.kind in kinds]
    if any(p.kind is inspect.Parameter.POSITIONAL_ONLY for p in found):
        raise ValueError(
            f"{maker.label}: parameters must be named ones; got positional-only. Remove the / from its parameters."
        )
    return {p.name: p.default is inspect.Parameter.empty for p in single}


def _is_own(module: ModuleType, key: str, value: Any) -> bool:
    return callable(value) and not key.startswith("_") and getattr(value, "__module__", None) == module.__name__


def _from_file(file: Path) -> ModuleType:
    """The module of a file, executed once for each version of it; its neighbours can be imported."""
    name = f"_jink_{file.stem}_{hash_files(file.resolve())}_{abs(hash(str(file.resolve())))}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file.resolve())
    if spec is None or spec.loader is None:
        raise ValueError(f"--estimator: file must be Python; got {file}. Use a .py file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    folder = str(file.resolve().parent)
    sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, SyntaxError):
            raise ValueError(
                f"--estimator: file must be Python; got {file.name}, line {error.lineno}: {error.msg}. Mend it."
            ) from error
        if not isinstance(error, Exception | SystemExit):
            raise
        raise ValueError(
            f"--estimator: file must import without an error; got {said(error)}. Mend {file.name}."
        ) from error
    finally:
        sys.path.remove(folder)
    return module


def _installed(place: str) -> ModuleType:
    try:
        return importlib.import_module(place)
    except ModuleNotFoundError as error:
        if error.name is not None and place.startswith(error.name):
            raise ValueError(
                f"--estimator: module must be installed; got '{place}'. Give a file as path/to/{place}.py:NAME."
            ) from error
        raise ValueError(f"--estimator: {error}. Install {error.name}.") from error
