"""The quality report of an extraction: what was found, what looks wrong, and what to set.

Every check is a function of a few numbers that says nothing or one `Finding`: a code for programs,
a sentence for people and the option to try. Findings of severity `warning` are the map's warnings
too; a `note` says what the map lacks though nobody need act. `assess.py` measures the numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

USE_SCALE = "use --scale"
"""What every warning of a unit says to do; merging knows by it which map was warned of."""

_ROOM_HEIGHTS = (1.9, 6.0)
"""Free heights that call for no question, m."""

_TALLEST_HALL = 15.0
"""Free height from which the cloud is rather in another unit than of a hall, m."""

_MOST_WITHOUT_ROOM = 0.25
"""Share of the voxels: with more in no room, something was missed."""
_NOISY = 0.03
"""Standard deviation of the points about their surfaces, m."""
_LEAST_FLAT = 0.35
"""Share of the points on thin surfaces; right clouds measured from 0.54, clumps of points 0.04."""

_LEAST_STRAIGHT = 0.4
"""Level and upright ones among those: buildings, attics too, from 0.54, spheres and hills to 0.28.
"""

_LEAST_UPRIGHT = 0.1
"""Share of upright surfaces: with fewer, walls were hardly seen."""
_MEASURED = 0.1
"""Share of the points in blocks with enough of them; of fewer nothing is told."""
_FLAT = 0.3
"""Height above the floor up to which all of a flat cloud lies, m."""
_LOW_VIEW = 2.2
"""Height above the floors up to which anything must have been seen, m."""
_LEAST_FILLED = 0.6
"""Share of the voxels that surfaces should have: with fewer they are too small."""
_LARGEST_VOXEL = 0.3
"""Edge up to which a larger voxel is advised, m."""
_LEAST_FLOOR = 0.5
"""Share of the rooms' area under which floor, or over which a ceiling, must have been seen."""
_MOST_BELOW_FLOOR = 0.2
"""Share of all voxels: with more, the lowest floor was missed."""
_SMALL_PART = 4.0
"""m²: rooms without a passage smaller than this are closets and scraps, no part of their own."""


@dataclass(frozen=True)
class Finding:
    """One thing worth knowing; `advice` names the option or setting to try, "" where none helps."""

    code: str
    severity: str
    message: str
    advice: str = ""

    @property
    def is_warning(self) -> bool:
        """Whether somebody should act on it."""
        return self.severity == "warning"

    def __str__(self) -> str:
        """Return message and advice in one line."""
        return f"{self.message}; {self.advice}" if self.advice else self.message


@dataclass(frozen=True)
class Quality:
    """What an extraction found and how good its input was.

    Lengths in m, areas in m², shares from 0 to 1. `unlabelled` is the share of voxels in no room,
    by reason. `floor_seen` and `ceiling_seen` are shares of the rooms' area. `parts` are the
    groups of rooms that passages join, largest first, with the area of each. Of the points in
    measured blocks, `flat` lie on thin surfaces, `straight` on level or upright ones and `upright`
    on upright ones. `seen_height` is how far above its floor anything was seen, in the storey where
    that is least, of those with a fifth of the voxels.
    """

    points: int
    voxels: int
    storeys: int
    rooms: int
    passages: int
    navigable_area: float
    unlabelled: dict[str, float]
    floor_seen: float
    ceiling_seen: float
    parts: tuple[tuple[tuple[int, ...], float], ...]
    noise: float
    flat: float
    straight: float
    upright: float
    surfaces_measured: float
    spacing: float
    clear_height: float | None
    seen_height: float
    tilt: float = 0.0
    findings: tuple[Finding, ...] = ()

    @property
    def tilt_deg(self) -> float:
        """The tilt in degrees."""
        return float(np.degrees(self.tilt))

    def warnings(self) -> tuple[str, ...]:
        """Return the findings that somebody should act on, in one line each."""
        return tuple(str(f) for f in self.findings if f.is_warning)

    def content(self) -> dict[str, Any]:
        """Return the report as map.json holds it; the tilt in degrees."""
        return {
            "points": self.points,
            "voxels": self.voxels,
            "storeys": self.storeys,
            "rooms": self.rooms,
            "passages": self.passages,
            "navigable_area": round(self.navigable_area, 2),
            "unlabelled": {reason: round(share, 4) for reason, share in self.unlabelled.items()},
            "floor_seen": round(self.floor_seen, 3),
            "ceiling_seen": round(self.ceiling_seen, 3),
            "parts": [{"rooms": list(rooms), "area": round(area, 2)} for rooms, area in self.parts],
            "tilt_deg": round(self.tilt_deg, 3),
            "noise": round(self.noise, 3),
            "flat": round(self.flat, 3),
            "straight": round(self.straight, 3),
            "upright": round(self.upright, 3),
            "spacing": round(self.spacing, 3),
            "clear_height": None if self.clear_height is None else round(self.clear_height, 2),
            "seen_height": round(self.seen_height, 2),
            "findings": [vars(f) for f in self.findings],
        }


def is_ordinary_height(height: float | None) -> bool:
    """Return whether rooms of this free height (m), or of an unknown one, call for no question."""
    return height is None or _ROOM_HEIGHTS[0] <= height <= _ROOM_HEIGHTS[1]


def findings(
    quality: Quality,
    voxel_size: float,
    unit: tuple[str, float, float] | None = None,
    upside_down: bool = False,
) -> tuple[Finding, ...]:
    """Return what is worth knowing of an extraction, the likeliest causes first.

    Parameters
    ----------
    quality : the numbers
    voxel_size : m, of the map
    unit : name and length in m of the unit that the cloud seems to be in, if not metres, and the
        free height in m that its rooms have then
    upside_down : whether the cloud seems to stand on its head
    """
    checks = (
        _scale(quality, unit),
        _upside_down(upside_down),
        _structure(quality),
        _walls(quality),
        _sparse(quality, voxel_size),
        _floor(quality),
        _ceiling(quality),
        _rooms(quality),
        _parts(quality),
    )
    return tuple(finding for check in checks for finding in check)


def _scale(quality: Quality, unit: tuple[str, float, float] | None) -> Iterator[Finding]:
    height = quality.clear_height
    if height is None or is_ordinary_height(height):
        return
    if unit is not None:
        name, length, in_unit = unit
        message = f"most free heights are {height:.3g} m, but {in_unit:.2g} m if it is in {name}"
        yield Finding("scale", "warning", message, f"{USE_SCALE} {length:g} if it is")
    elif not _ROOM_HEIGHTS[0] <= height <= _TALLEST_HALL:
        message = f"most free heights are {height:.3g} m, which rooms seldom have"
        yield Finding("scale", "warning", message, f"if it is not in metres, {USE_SCALE}")


def _upside_down(upside_down: bool) -> Iterator[Finding]:
    if upside_down:
        message = "the cloud seems to stand on its head: doors and furniture hang from the ceiling"
        yield Finding("upside_down", "warning", message, "use --up=-z, or -x or -y for --up x or y")


def _structure(quality: Quality) -> Iterator[Finding]:
    if quality.noise >= _NOISY:
        message = (
            f"surfaces are {2 * quality.noise * 100:.0f} cm thick (noise of about "
            f"{quality.noise * 100:.0f} cm): walls and doors blur"
        )
        advice = "register or filter the cloud first, or look for a map seen twice with an offset"
        yield Finding("noise", "warning", message, advice)
    elif quality.surfaces_measured < _MEASURED:
        return
    elif quality.flat < _LEAST_FLAT:
        message = (
            f"only {quality.flat:.0%} of the points lie on thin surfaces, in buildings most do"
        )
        yield Finding("structure", "warning", message, "is it a building?")
    elif quality.straight < _LEAST_STRAIGHT * quality.flat:
        message = (
            f"only {quality.straight / quality.flat:.0%} of the surfaces are level or upright, in "
            "buildings most are"
        )
        yield Finding("structure", "warning", message, "is it a building, with z up (--up)?")


def _walls(quality: Quality) -> Iterator[Finding]:
    if quality.surfaces_measured >= _MEASURED and quality.upright < _LEAST_UPRIGHT:
        message = f"hardly any walls were seen: {quality.upright:.0%} of the points lie on upright"
        advice = "is it a building?"
        if quality.seen_height < _FLAT:
            advice = (
                "the cloud is flat, as a 2D laser's is; one in 3D is needed, with floor and walls"
            )
        yield Finding("no_walls", "warning", f"{message} surfaces", advice)
    elif quality.rooms and 0.5 < quality.seen_height < _LOW_VIEW:
        message = (
            f"nothing was seen higher than {quality.seen_height:.1f} m above the floor, where "
            "walls are told from furniture"
        )
        yield Finding("low_view", "warning", message, "use a sensor that looks up, or tilt it")


def _sparse(quality: Quality, voxel_size: float) -> Iterator[Finding]:
    filled = -np.expm1(-((voxel_size / quality.spacing) ** 2))
    if filled >= _LEAST_FILLED or not is_ordinary_height(quality.clear_height):
        return
    # Nine tenths of the cells of a surface are hit where they are 1.5 spacings wide.
    wanted = np.ceil(1.5 * quality.spacing / 0.05) * 0.05
    message = (
        f"points lie {quality.spacing:.2f} m apart, too far for voxels of {voxel_size:g} m: "
        f"{1 - filled:.0%} of the surfaces' voxels are missing"
    )
    advice = f"use --voxel-size {wanted:.2f} or a denser cloud"
    if wanted > _LARGEST_VOXEL:
        advice = "a denser cloud is needed"
    yield Finding("sparse", "warning", message, advice)


def _floor(quality: Quality) -> Iterator[Finding]:
    if quality.unlabelled["below the floors"] > _MOST_BELOW_FLOOR:
        message = (
            f"{quality.unlabelled['below the floors']:.0%} of the voxels lie below the lowest "
            "floor found: the true floor was hardly seen, or another axis is up"
        )
        yield Finding("floor_missed", "warning", message, "scan the floor, or see --up")
    if quality.rooms and quality.floor_seen < _LEAST_FLOOR:
        message = f"the floor was seen under only {quality.floor_seen:.0%} of the rooms"
        yield Finding(
            "floor_gaps", "warning", message, "passages may be missing where it was not seen"
        )


def _ceiling(quality: Quality) -> Iterator[Finding]:
    if quality.rooms and quality.ceiling_seen < 1 - _LEAST_FLOOR:
        message = f"a ceiling was seen over only {quality.ceiling_seen:.0%} of the rooms"
        yield Finding(
            "ceiling_gaps", "note", message, "where there is none, rooms end 2.7 m above the floor"
        )


def _rooms(quality: Quality) -> Iterator[Finding]:
    if quality.rooms == 0:
        yield Finding("no_rooms", "warning", "no rooms found")
    elif quality.unlabelled["all"] > _MOST_WITHOUT_ROOM:
        without = quality.unlabelled["all"]
        message = f"{without:.0%} of the voxels belong to no room"
        reason = max(
            (k for k in quality.unlabelled if k != "all"), key=quality.unlabelled.__getitem__
        )
        yield Finding("unlabelled", "warning", message, f"most lie {reason}")


def _parts(quality: Quality) -> Iterator[Finding]:
    large = [part for part in quality.parts if part[1] >= _SMALL_PART]
    if len(large) < 2:
        return
    alone = sum(len(rooms) == 1 for rooms, _ in large)
    sizes = ", ".join(f"{len(rooms)} rooms {area:.0f} m²" for rooms, area in large[:4])
    sizes += ", ..." if len(large) > 4 else ""
    severity = "warning" if 2 * alone > quality.rooms and quality.rooms > 2 else "note"
    message = f"the rooms fall into {len(large)} parts with no passage between them ({sizes})"
    yield Finding("parts", severity, message, "doors may have been closed or their floor unseen")
