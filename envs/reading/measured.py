"""The measured part of a recorded row: components, noise and the sensor's place, in metres and radians."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jink.envs.reading.cells import numbers
from jink.envs.reading.columns import AXES, Choice
from jink.envs.reading.geodesy import Origin, to_local
from jink.envs.reading.tables import Table

Floats = NDArray[np.float64]


class Rows(NamedTuple):
    """Measurements of K rows, in file order.

    Fields: values (K, D), NaN = missing; noise (K, D, D) or None; places, the sensor's position then
    velocity, (K, 2 A) or None; origin of the local frame, or None where the file is in metres.
    """

    values: Floats
    noise: Floats | None
    places: Floats | None
    origin: Origin | None


def measured_rows(
    table: Table,
    choice: Choice,
    data: dict[str, Any],
    keep: NDArray[np.bool_],
    *,
    height: float | None = None,
    compass: bool = False,
    degrees: bool = False,
    bias: Mapping[str, float] | None = None,
    origin: Origin | None = None,
) -> Rows:
    """Convert the chosen columns of a file to measurements.

    Args:
        table: the opened file, named by refusals.
        choice: which column is what.
        data: the loaded columns.
        keep: rows in use; the others are not checked beyond being numbers; (K,).
        height: of the target, metres; see `read_tracks`.
        compass: bearings are clockwise from north.
        degrees: angles are in degrees.
        bias: known constant errors to subtract, by component.
        origin: of the local frame; None: the first fix in use.

    Returns:
        the rows.

    Raises:
        ValueError: a latitude, longitude, bearing, sigma or sensor place that cannot be; an option that does
            not fit.
    """
    if choice.geographic:
        values, origin = _local(table, choice, data, keep, origin)
    else:
        origin = None
        values = np.stack([_column(table, choice, data, name) for name in choice.components], axis=1)
    sigmas = _sigmas(table, choice, data, keep, values)
    angular = np.array([name in {"bearing", "elevation"} for name in choice.components])
    if degrees:
        values[:, angular] = np.deg2rad(values[:, angular])
        if sigmas is not None:
            sigmas[:, angular] = np.deg2rad(sigmas[:, angular])
    if "bearing" in choice.components:
        _turn_bearings(table, choice, keep, values[:, choice.components.index("bearing")], compass=compass)
    for name, constant in (bias or {}).items():
        if name not in choice.components or not np.isfinite(constant):
            raise ValueError(
                f"read_tracks: bias must give finite numbers for measured components, "
                f"{', '.join(choice.components)}; got {name}={constant}. Use metres, m/s and radians."
            )
        values[:, choice.components.index(name)] -= constant
    places = _places(table, choice, data, keep, values)
    if "range" in choice.components and choice.axes == 2 and "sensor_z" in choice.columns:
        _flatten_ranges(table, choice, numbers(table, *_pick(choice, data, "sensor_z")), values, sigmas, height)
    elif height is not None:
        raise ValueError(
            f"read_tracks: height must be left out unless ranges from sensors with heights are read in two "
            f"axes; "
            f"got {height}. Map sensor_z and use axes=2."
        )
    noise = None
    if sigmas is not None:
        noise = np.zeros((*values.shape, values.shape[1]))
        diagonal = np.arange(values.shape[1])
        noise[:, diagonal, diagonal] = np.where(np.isnan(values), 1.0, sigmas**2)
    return Rows(values, noise, places, origin)


def _pick(choice: Choice, data: dict[str, Any], name: str) -> tuple[str, Any]:
    return choice.columns[name], data[choice.columns[name]]


def _column(table: Table, choice: Choice, data: dict[str, Any], name: str) -> Floats:
    return numbers(table, *_pick(choice, data, name))


def _local(
    table: Table, choice: Choice, data: dict[str, Any], keep: NDArray[np.bool_], origin: Origin | None
) -> tuple[Floats, Origin]:
    """Degrees to local metres; a missing altitude leaves z missing, not x and y."""
    lat, lon = _column(table, choice, data, "lat"), _column(table, choice, data, "lon")
    alt = _column(table, choice, data, "z") if choice.axes == 3 else np.zeros_like(lat)
    for name, value, limit in (("lat", lat, 90.0), ("lon", lon, 360.0)):
        bad = np.flatnonzero(keep & (np.abs(value) > limit))
        if bad.size:
            row = int(bad[0])
            table.refuse_cell(
                row,
                choice.columns[name],
                f"lie within -{limit:g}..{limit:g} degrees",
                value[row],
                "Correct or empty the cell.",
            )
    fixes = np.flatnonzero(keep & np.isfinite(lat) & np.isfinite(lon))
    if not fixes.size:
        table.refuse("have a row with latitude and longitude", "none", "Map the columns that hold them.")
    if origin is None:
        known = alt[keep & np.isfinite(alt)]
        origin = Origin(float(lat[fixes[0]]), float(lon[fixes[0]]), float(known[0]) if known.size else 0.0)
    local = to_local(lat, lon, np.where(np.isnan(alt), origin.altitude, alt), origin)[:, : choice.axes]
    if choice.axes == 3:
        local[np.isnan(alt), 2] = np.nan
    return local, origin


def _sigmas(
    table: Table, choice: Choice, data: dict[str, Any], keep: NDArray[np.bool_], values: Floats
) -> Floats | None:
    names = [f"sigma_{name}" for name in choice.components]
    given = [name for name in names if name in choice.columns]
    if not given:
        return None
    if len(given) < len(names):
        table.refuse(f"have all of {', '.join(names)} or none", f"only {', '.join(given)}", "Add or unmap them.")
    sigmas = np.stack([_column(table, choice, data, name) for name in names], axis=1)
    bad = np.argwhere(keep[:, None] & ~(sigmas > 0) & ~(np.isnan(values) & np.isnan(sigmas)))
    if bad.size:
        row, component = (int(index) for index in bad[0])
        got = sigmas[row, component]
        table.refuse_cell(
            row,
            choice.columns[names[component]],
            "be a standard deviation > 0 where its component is measured",
            "an empty cell" if np.isnan(got) else got,
            "Correct the cell or empty the measurement.",
        )
    return sigmas


def _turn_bearings(table: Table, choice: Choice, keep: NDArray[np.bool_], bearing: Floats, *, compass: bool) -> None:
    """Wrap bearings to (-pi, pi], counter-clockwise from +x, in place."""
    bad = np.flatnonzero(keep & (np.abs(bearing) > 2 * np.pi + 1e-3))
    if bad.size:
        row = int(bad[0])
        table.refuse_cell(
            row,
            choice.columns["bearing"],
            "lie within one turn, -2 pi..2 pi rad",
            bearing[row],
            "Use degrees=True (--degrees) where angles are in degrees.",
        )
    turned = np.pi / 2 - bearing if compass else bearing
    bearing[:] = np.pi - np.mod(np.pi - turned, 2 * np.pi)


def _places(
    table: Table, choice: Choice, data: dict[str, Any], keep: NDArray[np.bool_], values: Floats
) -> Floats | None:
    if choice.kind == "position" or "sensor_x" not in choice.columns:
        return None
    places = np.zeros((len(values), 2 * choice.axes))
    measured = keep & np.isfinite(values).any(axis=1)
    for offset, prefix in ((0, "sensor_"), (choice.axes, "sensor_v")):
        for index, axis in enumerate(AXES[: choice.axes]):
            name = f"{prefix}{axis}"
            if name not in choice.columns:
                continue
            places[:, offset + index] = _column(table, choice, data, name)
            bad = np.flatnonzero(measured & np.isnan(places[:, offset + index]))
            if bad.size:
                table.refuse_cell(
                    int(bad[0]),
                    choice.columns[name],
                    "say where the sensor is",
                    "an empty cell",
                    "Fill the cell.",
                )
    return np.nan_to_num(places)


def _flatten_ranges(
    table: Table,
    choice: Choice,
    sensor_z: Floats,
    values: Floats,
    sigmas: Floats | None,
    height: float | None,
) -> None:
    """Slant to horizontal ranges, in place: r_h = sqrt(r^2 - dz^2), rates and sigmas times r / r_h."""
    if height is None:
        table.refuse(
            "be read with axes=3, or with the target's height,",
            "axes=2 and sensors with heights",
            "Use axes=3, or height=METRES in the sensors' datum.",
        )
    column = choice.components.index("range")
    slant = values[:, column].copy()
    squared = slant**2 - (height - sensor_z) ** 2
    flat = np.sqrt(np.where(squared > 0, squared, np.nan))
    values[:, column] = flat
    for index, name in enumerate(choice.components):
        if name == "range_rate":
            values[:, index] *= slant / flat
        if name in {"range", "range_rate"} and sigmas is not None:
            sigmas[:, index] *= slant / flat
