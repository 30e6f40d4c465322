"""Latitude and longitude to local metres: the WGS84 tangent plane at one reference point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SEMI_MAJOR_AXIS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)


class Origin(NamedTuple):
    """The point where a local east, north, up frame touches the ellipsoid: degrees, degrees, metres."""

    latitude: float
    longitude: float
    altitude: float


def earth_fixed(
    latitude: NDArray[np.float64], longitude: NDArray[np.float64], altitude: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Geodetic coordinates to earth-centred, earth-fixed ones.

    Model: x = (N + h) cos(lat) cos(lon), y = (N + h) cos(lat) sin(lon), z = (N (1 - e^2) + h) sin(lat),
    N = a / sqrt(1 - e^2 sin(lat)^2).

    Args:
        latitude: degrees, north positive; shape (K,).
        longitude: degrees, east positive; shape (K,).
        altitude: height above the ellipsoid; metres; shape (K,).

    Returns:
        x, y, z; shape (K, 3); metres.

    Source: NIMA TR8350.2 (2000), section 4 (WGS84). Differs: none.
    """
    lat, lon = np.deg2rad(latitude), np.deg2rad(longitude)
    normal = SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(lat) ** 2)
    across = (normal + altitude) * np.cos(lat)
    along = (normal * (1.0 - ECCENTRICITY_SQUARED) + altitude) * np.sin(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), along], axis=-1)


def to_local(
    latitude: NDArray[np.float64],
    longitude: NDArray[np.float64],
    altitude: NDArray[np.float64],
    origin: Origin,
) -> NDArray[np.float64]:
    """Geodetic coordinates to east, north, up metres on the tangent plane at `origin`.

    The plane is exact as a frame, but far from the origin `up` falls away as d^2 / (2 R): 8 m at 10 km, 785
    m at 100 km, and horizontal distances shrink by d^3 / (6 R^2): 4 m at 100 km.

    Args:
        latitude: degrees; shape (K,).
        longitude: degrees; shape (K,).
        altitude: metres above the ellipsoid (or any datum that `origin` shares); shape (K,).
        origin: where the plane touches; its own local coordinates are zero.

    Returns:
        east, north, up; shape (K, 3); metres; NaN where an input is NaN.

    Source: NIMA TR8350.2 (2000), section 4; rotation by the origin's latitude and longitude. Differs: none.
    """
    centre = earth_fixed(*(np.array([value]) for value in origin))[0]
    offset = earth_fixed(latitude, longitude, altitude) - centre
    lat, lon = np.deg2rad(origin.latitude), np.deg2rad(origin.longitude)
    rotation = np.array(
        [
            [-np.sin(lon), np.cos(lon), 0.0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )
    return np.asarray(offset @ rotation.T)
