"""What extraction and merging cost as buildings and the number of agents grow.

Every size is a generated office. Agents see overlapping stretches of it, each half of what the next
one sees. Ray casting would take longer than what is measured, so clouds are sampled from the
surfaces (`simulation.surfaces`). Sampling, extraction and merging run in processes of their own,
one after the other, so that each peak of memory is of that step alone (with its libraries). Sizes
are kept as they come; the same command goes on where it stopped.
"""

from __future__ import annotations

import csv
import io
import itertools
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from topometric_ros.alignment import MergeResult
from topometric_ros.evaluation.benchmark_pairs import BenchmarkError
from topometric_ros.evaluation.metrics_fusion import RIGHT, bytes_on_the_wire
from topometric_ros.evaluation.processes import ProcessError, in_own_process, peak_mb
from topometric_ros.fusion.merge import MOST_AGENTS, merge
from topometric_ros.fusion.poses import angle, apart, apply, inverse
from topometric_ros.io.map_files import load_map, save_map
from topometric_ros.io.summaries import write_atomically
from topometric_ros.runtime.config import preset_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.degrade import DegradeConfig, random_frame
from topometric_ros.simulation.surfaces import sampled_surfaces
from topometric_ros.stopwatch import Stopwatch

ROWS = "scaling.csv"
_HEAD = ("rooms", "agents", "measure", "value")
_WARM_UP = (3, 2)

_MOST_OF_STOREY = 300
"""Rooms along one corridor, some 450 m: more of them are put on further storeys."""

Measures = dict[str, float]
"""`extract.<stage>` and `merge.<stage>`: CPU seconds, of all agents or pairs together;
`extract.peak_mb`, `merge.peak_mb`; `points`, `voxels`, `map_bytes` (CDR): of the largest agent;
`true_rooms`, `true_links`; `global_bytes`, `rooms_found`, `passages_found`: of the global map;
`pairs`, `sharing`, `accepted`, `wrong`: of agents."""


@dataclass(frozen=True, order=True)
class Size:
    """Rooms along the corridor, as the generator is asked for them, and agents."""

    rooms: int
    agents: int


def sizes_of(rooms: Sequence[int], agents: Sequence[int]) -> list[Size]:
    """Return the sizes: all buildings with the fewest agents, the middle one with all numbers.

    Examples
    --------
    >>> sizes_of([10, 30, 100], [2, 5])
    [Size(rooms=10, agents=2), Size(rooms=30, agents=2), Size(rooms=100, agents=2), \
Size(rooms=30, agents=5)]
    """
    if not rooms or not agents or min(rooms) < 1 or not 2 <= min(agents) <= max(agents):
        raise BenchmarkError("scaling takes 1 and more rooms and 2 and more agents")
    if max(agents) > MOST_AGENTS:
        raise BenchmarkError(f"{max(agents)} agents; at most {MOST_AGENTS} can be merged")
    rooms, agents = sorted(set(rooms)), sorted(set(agents))
    middle = rooms[len(rooms) // 2]
    return [*(Size(r, agents[0]) for r in rooms), *(Size(middle, n) for n in agents[1:])]


def run_scaling(
    sizes: Sequence[Size],
    out: Path,
    *,
    timeout: float = 600.0,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[dict[Size, Measures], dict[Size, str]]:
    """Measure every size that `out` does not hold yet; return all, and what went wrong.

    A size that went wrong is tried again by the next run, and so is one measured before passages
    were counted: its clouds had no doorways.

    Parameters
    ----------
    timeout : wall seconds after which a step of a size is ended

    Raises
    ------
    BenchmarkError
        The rows in `out` are not of this benchmark.
    """
    out.mkdir(parents=True, exist_ok=True)
    known = {size: m for size, m in read_scaling(out / ROWS).items() if "passages_found" in m}
    failed: dict[Size, str] = {}
    open_sizes = [size for size in sizes if size not in known]
    if open_sizes:
        progress("warming up")
        # Compiles the hot loops, or else the first size would pay for it.
        measure(Size(*_WARM_UP), timeout=max(timeout, 600.0))
    for k, size in enumerate(open_sizes):
        progress(f"{k + 1} of {len(open_sizes)}: {size.rooms} rooms, {size.agents} agents")
        try:
            known[size] = measure(size, timeout=timeout)
        except ProcessError as error:
            failed[size] = str(error)
        else:
            write_scaling(out / ROWS, known)
    return {size: known[size] for size in sizes if size in known}, failed


def measure(size: Size, *, timeout: float) -> Measures:
    """Measure one size; raises ProcessError where a step fails or takes too long."""
    with tempfile.TemporaryDirectory() as name:
        measures: Measures = {}
        for step in (sample_clouds, extract_maps, merge_maps):
            measures |= in_own_process(step, size, Path(name), timeout=timeout)
    return measures


def sample_clouds(size: Size, folder: Path) -> Measures:
    """Write each agent's points, in a frame of its own, and that frame."""
    storeys = -(-size.rooms // _MOST_OF_STOREY)
    building = load_building(f"office:seed=1,rooms={size.rooms},storeys={storeys}")
    low, high = building.vertices[:, 0].min(), building.vertices[:, 0].max()
    step = (high - low) / (size.agents + 1)
    most = 0
    for k in range(size.agents):
        rng = np.random.default_rng((1, k))
        stretch = (low + k * step, low + (k + 2) * step)
        T_agent_building = random_frame(DegradeConfig(), rng)
        points = sampled_surfaces(building, stretch, rng)
        np.save(folder / f"{k}.frame.npy", T_agent_building)
        np.save(folder / f"{k}.npy", apply(T_agent_building, points).astype(np.float32))
        most = max(most, len(points))
    counts = {"true_rooms": len(building.rooms), "true_links": len(building.links)}
    return {**counts, "points": most}


def extract_maps(size: Size, folder: Path) -> Measures:
    """Write each agent's map."""
    config = preset_config("default")
    watch = Stopwatch()
    voxels = most_bytes = 0
    for k in range(size.agents):
        points = np.load(folder / f"{k}.npy").astype(np.float64)
        extraction = extract_map(
            points, config.extraction, config.merge.matching, agent=f"{k}", session=f"{k}"
        )
        del points
        watch.add(extraction.timings, "extract.")
        save_map(folder / f"{k}.tmap", extraction.map)
        voxels = max(voxels, len(extraction.map.voxels))
    measures = {**watch.seconds, "extract.peak_mb": peak_mb()}
    for k in range(size.agents):
        most_bytes = max(most_bytes, bytes_on_the_wire(load_map(folder / f"{k}.tmap")))
    return {**measures, "voxels": voxels, "map_bytes": most_bytes}


def merge_maps(size: Size, folder: Path) -> Measures:
    """Merge the maps and count right and wrong alignments."""
    maps = [load_map(folder / f"{k}.tmap") for k in range(size.agents)]
    result = merge(maps, preset_config("default").merge)
    measures = {f"merge.{stage}": value for stage, value in result.timings.items()}
    measures["merge.peak_mb"] = peak_mb()
    measures["global_bytes"] = bytes_on_the_wire(result.global_map.map)
    measures["rooms_found"] = len(result.global_map.map.rooms)
    measures["passages_found"] = len(result.global_map.map.passages)
    return {**measures, **_counts(result, size, folder)}


def _counts(result: MergeResult, size: Size, folder: Path) -> Measures:
    """Return how many pairs there are, share anything, were accepted, and wrongly so."""
    frames = [np.load(folder / f"{k}.frame.npy") for k in range(size.agents)]
    pairs = list(itertools.combinations(range(size.agents), 2))
    accepted = wrong = 0
    for (a, b), alignment in zip(pairs, result.alignments, strict=True):
        if alignment.accepted and alignment.T_a_b is not None:
            T_a_b = frames[a] @ inverse(frames[b])
            points = np.load(folder / f"{b}.npy", mmap_mode="r")[::997].astype(np.float64)
            turn = np.degrees(angle(inverse(T_a_b) @ alignment.T_a_b))
            off = apart(alignment.T_a_b, T_a_b, points) >= RIGHT[0] or turn >= RIGHT[1]
            accepted += 1
            wrong += b - a > 1 or off
    sharing = size.agents - 1
    return {"pairs": len(pairs), "sharing": sharing, "accepted": accepted, "wrong": wrong}


def read_scaling(path: Path) -> dict[Size, Measures]:
    """Return what an earlier run measured; nothing where there is no file.

    Raises
    ------
    BenchmarkError
        The file has other columns.
    """
    known: dict[Size, Measures] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for cells in csv.DictReader(file):
                size = Size(int(cells["rooms"]), int(cells["agents"]))
                known.setdefault(size, {})[cells["measure"]] = float(cells["value"])
    except FileNotFoundError:
        return {}
    except (KeyError, TypeError, ValueError) as error:
        raise BenchmarkError(f"{path}: not the rows of this benchmark: {error}") from error
    return known


def write_scaling(path: Path, known: dict[Size, Measures]) -> None:
    """Write all measures as CSV in one step."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_HEAD)
    for size, measures in sorted(known.items()):
        writer.writerows((size.rooms, size.agents, k, f"{v:.4f}") for k, v in measures.items())
    write_atomically(path, stream.getvalue().encode())


def seconds_of(measures: Measures, step: str) -> Measures:
    """Return the CPU seconds of a step ("extract" or "merge") by stage, in the order of stages."""
    names: Iterable[str] = (name for name in measures if name.startswith(f"{step}."))
    return {n.partition(".")[2]: measures[n] for n in names if not n.endswith("peak_mb")}
