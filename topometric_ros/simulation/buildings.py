"""Buildings by name: made by the generator, or loaded from a file or folder that is there."""

from __future__ import annotations

from pathlib import Path

from topometric_ros.simulation.bim import load_bim
from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.floor_plan import load_floor_plan
from topometric_ros.simulation.generator import generate, is_generated, parse_generator
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.simulation.labelled_clouds import load_cslamd, load_ply, load_s3dis
from topometric_ros.simulation.sidecars import with_sidecars

_FILES = {".npz": load_bim, ".png": load_floor_plan, ".ply": load_ply}


def load_building(spec: str, *, sidecars: bool = True) -> LabelledBuilding:
    """Return a building with its rooms and links.

    Parameters
    ----------
    spec : "office:seed=3,rooms=20,corridor=ring" (also home, hospital: `GeneratorConfig`), or the
        path of a BIM model (.npz), a floor plan (.png), a labelled cloud (.ply), a folder of
        S3DIS (Area_1) or one of the Collaborative SLAM data set. Sidecar files beside a path
        replace the links that were found (docs/simulation.md).
    sidecars : whether they do

    Raises
    ------
    BuildingError
        The building is of no known kind, or its files are damaged.
    ConfigurationError
        A generator's parameter is unknown or out of range.
    """
    if is_generated(spec):
        return generate(parse_generator(spec))
    path = Path(spec)
    if path.is_dir():
        building = _load_folder(path)
    elif not path.exists():
        raise BuildingError(f"{spec}: no such file, and no generator (office, home, hospital)")
    elif path.suffix.lower() not in _FILES:
        raise BuildingError(f"{spec}: expected {', '.join(_FILES)} or a folder")
    else:
        building = _FILES[path.suffix.lower()](path)
    return with_sidecars(building, path) if sidecars else building


def _load_folder(path: Path) -> LabelledBuilding:
    """Rooms in folders of their own: S3DIS; maps with transforms beside them: CSLAMD."""
    if any(path.glob("*/*.txt")):
        return load_s3dis(path)
    if any(path.glob("*.ply")) or any(path.glob("meshes/*.ply")):
        return load_cslamd(path)
    raise BuildingError(f"{path}: neither <room>/<room>.txt as in S3DIS nor .ply maps are in it")
