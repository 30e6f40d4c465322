"""Names of the track format, the names recognised in files of others, and mappings between them."""

from __future__ import annotations

import difflib

AXES = ("x", "y", "z")
POLAR = ("range", "bearing", "elevation")
GEOGRAPHIC = ("lat", "lon", "alt")
COMPONENTS = (*AXES, *POLAR, "range_rate")
NAMES = (
    "t",
    "track",
    *COMPONENTS,
    *GEOGRAPHIC,
    "sensor",
    "intent",
    *(f"{prefix}{axis}" for prefix in ("sensor_", "sensor_v", "true_", "true_v", "v") for axis in AXES),
    *(f"sigma_{name}" for name in COMPONENTS),
)
"""Every name of the track format; `vx, vy, vz` are read from truth files only."""
TIME_NAMES = ("t", "time", "timestamp", "t_s", "time_s", "seconds", "datetime")
TRACK_NAMES = ("track", "track_id", "aircraft", "icao24", "mmsi", "target", "target_id", "id")
INTENT_NAMES = ("intent", "label", "state_name")
SENSOR_NAMES = ("sensor", "sensor_id", "anchor", "beacon")
PLANE_PAIRS = (
    ("x", "y"),
    ("east", "north"),
    ("x_m", "y_m"),
    ("east_m", "north_m"),
    ("easting", "northing"),
    ("rel_east", "rel_north"),
)
GEOGRAPHIC_PAIRS = (
    ("lat", "lon"),
    ("latitude", "longitude"),
    ("latitude_degrees", "longitude_degrees"),
    ("lat", "lng"),
    ("lat_deg", "lon_deg"),
)
HEIGHT_NAMES = (
    "z", "alt", "up", "z_m", "alt_m", "altitude", "altitude_m", "height", "height_m", "ele", "elevation",
    "gps_alt", "gps_altitude", "press_alt", "baroaltitude", "geoaltitude",
)  # fmt: skip
RANGE_NAMES = ("range", "range_m", "distance", "distance_m")
BEARING_NAMES = ("bearing", "bearing_rad", "azimuth", "azimuth_rad")
ELEVATION_NAMES = ("elevation", "elevation_rad")


def parse_columns(text: str) -> dict[str, str]:
    """Read a mapping such as ``t=time,x=east,y=north``: our name, an equals sign, the file's column.

    An empty column (``track=``) says that the file has none, whatever its columns are called.

    Args:
        text: comma-separated pairs; empty: no mapping.

    Returns:
        our names to the file's columns.

    Raises:
        ValueError: a part without "=", an unknown name, or a name given twice.
    """
    pairs: dict[str, str] = {}
    for part in text.split(","):
        if not part.strip():
            continue
        name, equals, column = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise ValueError(
                f"parse_columns: columns must be pairs like t=time,x=east; got '{part.strip()}'. Write NAME=COLUMN."
            )
        check_name(name, "parse_columns")
        if name in pairs:
            raise ValueError(f"parse_columns: columns must give each name once; got '{name}' twice. Remove one.")
        pairs[name] = column
    return pairs


def check_name(name: str, caller: str) -> None:
    """Refuse a name that the track format does not have."""
    if name not in NAMES:
        near = difflib.get_close_matches(name, NAMES, n=1)
        hint = f"Did you mean {near[0]}?" if near else f"Names: {', '.join(NAMES)}."
        raise ValueError(f"{caller}: columns must use the track format's names; got '{name}'. {hint}")
