"""Values of command-line options that are more than a number: `range=2.8`, `gps_new=1`, `1,0.01`."""

from __future__ import annotations

import math
from collections.abc import Iterable

from jink.estimators.sensor import Sensor

__all__ = ["parse_numbers", "parse_pairs", "parse_sigma"]


LEAST_SIGMA, MOST_SIGMA = 1e-12, 1e12


def parse_pairs(option: str, values: Iterable[str]) -> dict[str, str]:
    """``name=value`` pairs, comma-separated or repeated.

    Raises:
        ValueError: a part without "=", or a name given twice.
    """
    pairs: dict[str, str] = {}
    for part in (piece.strip() for text in values for piece in text.split(",")):
        if not part:
            continue
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not (name and equals):
            raise ValueError(f"{option}: value must be NAME=VALUE; got '{part}'. Write for example gps_new=1.")
        if name in pairs:
            raise ValueError(f"{option}: value must give each name once; got '{name}' twice. Remove one.")
        pairs[name] = value
    return pairs


def parse_numbers(option: str, values: Iterable[str]) -> dict[str, float]:
    """``name=number`` pairs.

    Raises:
        ValueError: as `parse_pairs`, or a value that is not a finite number.
    """
    return {name: _number(option, value) for name, value in parse_pairs(option, values).items()}


def parse_sigma(text: str, sensor: Sensor, degrees: bool = False) -> tuple[float, ...]:
    """Standard deviation of each component: one number for all, a list in order, or ``sigma_<name>=`` pairs.

    Args:
        text: for instance ``15``, ``1,0.01`` or ``sigma_range=1,sigma_bearing=.01``.
        sensor: its labels name the components.
        degrees: angles are in degrees, as in the file (``--degrees``).

    Returns:
        one per component, angles in rad; (D,).

    Raises:
        ValueError: not a number from 1e-12 to 1e12, a wrong count, an unknown or a missing component, or one number for
            components of different units.
    """
    names = [label.replace(" ", "_") for label in sensor.labels]
    units = [unit.replace("rad", "deg") if degrees else unit for unit in sensor.units]
    wanted = ", ".join(f"sigma_{name} in {unit}" for name, unit in zip(names, units, strict=True))
    if "=" in text:
        given = {k.removeprefix("sigma_"): v for k, v in parse_numbers("--sigma", [text]).items()}
        if set(given) != set(names):
            raise ValueError(f"--sigma: value must name {wanted}; got '{text}'. Give each once.")
        values = [given[name] for name in names]
    else:
        values = [_number("--sigma", part) for part in text.split(",")]
        if len(values) == 1 and len(set(sensor.units)) == 1:
            values = values * sensor.size
        if len(values) != sensor.size:
            raise ValueError(
                f"--sigma: value must have {sensor.size} numbers, {wanted}; got '{text}'. "
                f"Write for example --sigma {','.join(f'sigma_{name}=1' for name in names)}."
            )
    if any(value <= 0 for value in values):
        raise ValueError(f"--sigma: value must be > 0; got '{text}'. Give standard deviations: {wanted}.")
    if any(not LEAST_SIGMA <= value <= MOST_SIGMA for value in values):
        raise ValueError(
            f"--sigma: value must be from {LEAST_SIGMA:g} to {MOST_SIGMA:g}; got '{text}'. Give standard deviations: "
            f"{wanted}."
        )
    pairs = zip(values, sensor.units, strict=True)
    return tuple(math.radians(value) if degrees and unit == "rad" else value for value, unit in pairs)


def _number(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{option}: value must be a finite number; got '{text.strip()}'. Use SI units.")
    return value
