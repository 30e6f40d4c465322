"""Which column of a file is what: explicit mappings, recognised names, and the sensor they imply."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import NamedTuple, NoReturn

from jink.envs.reading.column_names import (
    AXES,
    BEARING_NAMES,
    ELEVATION_NAMES,
    GEOGRAPHIC_PAIRS,
    HEIGHT_NAMES,
    INTENT_NAMES,
    NAMES,
    PLANE_PAIRS,
    POLAR,
    RANGE_NAMES,
    SENSOR_NAMES,
    TIME_NAMES,
    TRACK_NAMES,
    check_name,
    parse_columns,
)
from jink.envs.reading.tables import Table
from jink.estimators.sensors import SENSORS

__all__ = ["AXES", "Choice", "choose_columns", "parse_columns"]


class Choice(NamedTuple):
    """What a file gives: our names to its columns, measured components in order, sensor kind, axes, frame."""

    columns: dict[str, str]
    components: tuple[str, ...]
    kind: str
    axes: int
    geographic: bool


def choose_columns(
    table: Table,
    columns: Mapping[str, str] | None,
    axes: int | None,
    *,
    flag: str = "--columns",
    clock: bool = True,
    truth: bool = False,
) -> Choice:
    """Decide what each column is: the caller's mapping first, then recognised names.

    Case and a unit in brackets do not count ("Altitude (m)" is "altitude"). The first name present wins for
    time, and the first complete pair for position, metres before degrees; two different track, height, label
    or sensor names are ambiguous and refused unless one is our own. A mapped measurement switches the
    recognition of other measurements off. Heights are recognised only for three axes or under the name z;
    `ax` and `bx` are sensor positions only beside a range and a column `anchor` or `beacon`.

    Args:
        table: the opened file.
        columns: our names to its columns; an empty column: none; None: recognise everything.
        axes: 2 or 3; None: 3 where a height or an elevation was mapped or a column is called z, 2 otherwise.
        flag: command-line option to name as the remedy.
        clock: whether a time column is needed.
        truth: whether this is a truth file, whose `vx, vy[, vz]` are velocities to read.

    Returns:
        the choice.

    Raises:
        ValueError: something is missing, ambiguous, unknown or contradictory.
    """
    return _Chooser(table, dict(columns or {}), flag).choose(axes, clock=clock, truth=truth)


class _Chooser:
    """One decision over one file: its normalised names and the caller's mapping."""

    def __init__(self, table: Table, mapping: dict[str, str], flag: str) -> None:
        self.table, self.mapping, self.flag = table, mapping, flag
        self.plain: dict[str, list[str]] = {}
        for name in table.names:
            key = re.sub(r"\s*[(\[].*?[)\]]\s*$", "", name).strip().lower()
            self.plain.setdefault(re.sub(r"[\s-]+", "_", key), []).append(name)
        for name, column in mapping.items():
            check_name(name, "read_tracks")
            if column and column not in table.names:
                near = difflib.get_close_matches(column, table.names, n=1)
                self.refuse(f"have the column '{column}' mapped to {name}", f"Did you mean {near[0]}?" if near else "")

    def refuse(self, rule: str, remedy: str = "") -> NoReturn:
        self.table.refuse(
            rule,
            f"columns {self.table.columns_text}",
            remedy or f"Say which is which with {self.flag}, for example {self.flag} t=time,x=east,y=north.",
        )

    def find(self, name: str) -> str | None:
        """The file's column of this (normalised) name; two spellings of one name are ambiguous."""
        if name in self.table.names:
            return name
        found = self.plain.get(name, [])
        if len(found) > 1:
            self.refuse(f"have one column for {name}, not {' and '.join(found)}")
        return found[0] if found else None

    def first(self, names: tuple[str, ...]) -> str | None:
        return next((column for name in names if (column := self.find(name))), None)

    def only(self, ours: str, names: tuple[str, ...]) -> str | None:
        """The mapped column, or the single recognised one; several different ones are ambiguous.

        Our own name settles it, but for `track`, which aircraft data use for the heading.
        """
        if ours in self.mapping:
            return self.mapping[ours] or None
        exact = None if ours == "track" else self.find(ours)
        if exact:
            return exact
        found = list(dict.fromkeys(column for name in names if (column := self.find(name))))
        if len(found) > 1:
            self.refuse(
                f"have one column for {ours}, not {' and '.join(found)}",
                f"Choose with {self.flag} {ours}={found[-1]} (or {ours}= for none).",
            )
        return found[0] if found else None

    def choose(self, axes: int | None, *, clock: bool, truth: bool) -> Choice:
        """The whole decision."""
        chosen: dict[str, str | None] = {}
        chosen["t"] = self.mapping["t"] if "t" in self.mapping else self.first(TIME_NAMES)
        if clock and not chosen["t"]:
            self.refuse("have a time column")
        chosen["track"] = self.only("track", TRACK_NAMES)
        chosen["sensor"] = self.only("sensor", SENSOR_NAMES)
        chosen["intent"] = self.only("intent", INTENT_NAMES)
        measured = self.measured()
        geographic = "lat" in measured
        plane = geographic or "x" in measured
        axes = self.add_third(chosen, measured, plane, axes)
        if not plane:
            self.add_places(chosen)
            if axes is None:
                high = bool(chosen.get("sensor_z")) and "bearing" not in measured
                axes = 3 if "elevation" in measured or high else 2
        components: tuple[str, ...] = (
            AXES[:axes] if plane else tuple(name for name in (*POLAR, "range_rate") if name in measured)
        )
        if "range_rate" in measured and plane:
            self.refuse("have range and bearing, or no range_rate: x, y and range_rate do not go together")
        if "elevation" in measured and axes == 2:
            self.refuse("be read with three axes when it has an elevation", "Use axes 3 or do not map elevation.")
        kind = "position" if plane else _kind(components)
        if kind not in SENSORS:
            self.refuse(
                f"hold what one sensor measures ({', '.join(SENSORS)}), not {kind}",
                f"Leave a measurement out with {self.flag}, for example {self.flag} range_rate=.",
            )
        for name in components:
            chosen[f"sigma_{name}"] = self.own(f"sigma_{name}")
        for axis in AXES[: axes or 2]:
            chosen[f"true_{axis}"] = self.own(f"true_{axis}")
            chosen[f"true_v{axis}"] = self.own(f"true_v{axis}")
            if truth:
                chosen[f"v{axis}"] = self.own(f"v{axis}")
        columns = {name: column for name, column in (chosen | measured).items() if column}
        columns = {name: columns[name] for name in NAMES if name in columns}
        return Choice(columns, components, kind, axes or 2, geographic)

    def pair(self, pairs: tuple[tuple[str, str], ...]) -> tuple[str, str] | None:
        """The first pair of names of which the file has both."""
        for names in pairs:
            first, second = self.find(names[0]), self.find(names[1])
            if first and second:
                return first, second
        return None

    def own(self, name: str) -> str | None:
        """The mapped column, or the one of exactly this name."""
        return (self.mapping[name] or None) if name in self.mapping else self.find(name)

    def measured(self) -> dict[str, str]:
        """The measured columns but for the third axis, mapped or recognised."""
        primary = ("x", "y", "lat", "lon", "range", "bearing", "range_rate")
        if any(self.mapping.get(name) for name in primary):
            found = {name: self.mapping[name] for name in primary if self.mapping.get(name)}
        else:
            plane, globe = self.pair(PLANE_PAIRS), self.pair(GEOGRAPHIC_PAIRS)
            options = {"range": self.first(RANGE_NAMES), "bearing": self.first(BEARING_NAMES)}
            polar = {name: column for name, column in options.items() if column and self.mapping.get(name, column)}
            if (plane or globe) and polar:
                self.refuse(
                    "have one kind of measurement, position or range and bearing",
                    f"Choose with {self.flag}, for example {self.flag} "
                    f"{next(iter(polar))}={next(iter(polar.values()))}.",
                )
            if plane:
                found = dict(zip(("x", "y"), plane, strict=True))
            else:
                found = dict(zip(("lat", "lon"), globe, strict=True)) if globe else polar
            if polar and (rate := self.own("range_rate")):
                found["range_rate"] = rate
        for pair in (("x", "y"), ("lat", "lon")):
            if (pair[0] in found) != (pair[1] in found):
                self.refuse(f"have both {pair[0]} and {pair[1]}")
        if not found:
            self.refuse("have a position (x and y, or lat and lon), a range or a bearing")
        if ("x" in found) + ("lat" in found) + bool({"range", "bearing"} & found.keys()) > 1:
            self.refuse("have one kind of measurement: x and y, lat and lon, or range and bearing")
        return found

    def add_third(
        self, chosen: dict[str, str | None], measured: dict[str, str], plane: bool, axes: int | None
    ) -> int | None:
        """Add height or elevation where it belongs; the number of axes if that decides it."""
        if not plane:
            column = self.mapping.get("elevation", None if axes == 2 else self.first(ELEVATION_NAMES))
            if column and "bearing" in measured:
                measured["elevation"] = column
            return axes
        column = self.mapping.get("z") or self.mapping.get("alt")
        if not column and "z" not in self.mapping:
            column = self.find("z")
        if axes is None:
            axes = 3 if column else 2
        if axes == 3:
            column = column or self.only("z", HEIGHT_NAMES)
            if not column:
                self.refuse(
                    "have a height column for three axes",
                    f"Name it with {self.flag} z=COLUMN, or use axes 2.",
                )
            chosen["z"] = column
        return axes

    def add_places(self, chosen: dict[str, str | None]) -> None:
        """Add where the sensor of each row stands."""
        for axis, compass in zip(AXES, ("east", "north", "up"), strict=True):
            names = [f"sensor_{axis}", f"own_{axis}", f"own_{compass}"]
            for owner, short in (("anchor", f"a{axis}"), ("beacon", f"b{axis}")):
                names += [f"{owner}_{axis}"] + ([short] if self.find(owner) else [])
            ours = f"sensor_{axis}"
            chosen[ours] = (self.mapping[ours] or None) if ours in self.mapping else self.first(tuple(names))
            chosen[f"sensor_v{axis}"] = self.own(f"sensor_v{axis}")
        if bool(chosen["sensor_x"]) != bool(chosen["sensor_y"]):
            self.refuse("have both sensor_x and sensor_y")


def _kind(components: tuple[str, ...]) -> str:
    """The sensor's name in the registry: the components joined, a range rate after a bearing as "rate"."""
    rate = "rate" if "bearing" in components else "range-rate"
    return "-".join(rate if name == "range_rate" else name for name in components)
