"""Reads and writes files of candidate grasps.

There are two formats. JSON holds poses of the grasp frame as ``grasp.py`` defines it. HDF5 is the format of
DefGraspSim, with another frame and another order of the quaternion; it is converted here and nowhere else.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from defgrasp_ros.errors import EmptyGraspListError, InvalidGraspError, NotFoundError
from defgrasp_ros.grasp import QUATERNION_NORM_TOLERANCE, Grasp
from defgrasp_ros.gripper import load_gripper

HDF5_GRIPPER = "franka_hand"
"""The hand whose base frame the poses of a DefGraspSim file belong to."""

TURN_TO_OUR_FRAME = Rotation.from_euler("z", 90.0, degrees=True)
"""From the original's axes to ours."""

GRASP_KEYS = ("id", "position", "orientation", "target_force")
REQUIRED_KEYS = ("position", "orientation")


def read_grasps(path: Path | str) -> list[Grasp]:
    """Read candidate grasps.

    ``.json``: ``{"grasps": [{"id": "top", "position": [x, y, z], "orientation": [x, y, z, w], "target_force": 1.0}]}``
    or the list alone; ``id`` (default: the row) and ``target_force`` may be left out. ``.h5``, ``.hdf5``: dataset
    ``poses`` of DefGraspSim, see ``grasp_from_defgraspsim``.

    Raises:
        NotFoundError: If there is no such file.
        EmptyGraspListError: If the file holds no grasp.
        InvalidGraspError: If it cannot be read or a grasp is faulty; the text names file, row and field.
    """
    path = Path(path)
    if not path.is_file():
        raise NotFoundError(f"grasp file '{path}' does not exist" if not path.exists() else f"'{path}' is not a file")
    readers = {".json": _read_json, ".h5": _read_hdf5, ".hdf5": _read_hdf5}
    if path.suffix.lower() not in readers:
        raise InvalidGraspError(f"{path}: extension '{path.suffix}' is unknown; known: {', '.join(readers)}")
    try:
        grasps = readers[path.suffix.lower()](path)
    except InvalidGraspError as error:
        raise InvalidGraspError(f"{path}: {error}") from error
    except OSError as error:
        raise InvalidGraspError(f"{path}: cannot be read: {error}") from error
    if not grasps:
        raise EmptyGraspListError(f"{path}: holds no grasp; give at least one")
    return grasps


def write_grasps(path: Path | str, grasps: Iterable[Grasp]) -> None:
    """Write grasps to a file from which ``read_grasps`` gets them back.

    In JSON, numbers survive to the bit, except that normalising a quaternion again may change its last one. The
    HDF5 format of DefGraspSim holds nothing but poses: ids become row numbers, target forces are lost.

    Raises:
        InvalidGraspError: If the extension is neither ``.json`` nor ``.h5`` nor ``.hdf5``.
    """
    path = Path(path)
    writers = {".json": _write_json, ".h5": _write_hdf5, ".hdf5": _write_hdf5}
    if path.suffix.lower() not in writers:
        raise InvalidGraspError(f"{path}: extension '{path.suffix}' is unknown; known: {', '.join(writers)}")
    writers[path.suffix.lower()](path, grasps)


def _write_json(path: Path, grasps: Iterable[Grasp]) -> None:
    entries = []
    for grasp in grasps:
        entry = {"id": grasp.id, "position": grasp.position.tolist(), "orientation": grasp.orientation.tolist()}
        if grasp.target_force is not None:
            entry["target_force"] = grasp.target_force
        entries.append(entry)
    path.write_text(json.dumps({"grasps": entries}, indent=2) + "\n")


def _write_hdf5(path: Path, grasps: Iterable[Grasp]) -> None:
    import h5py

    poses = np.array([pose_of_defgraspsim(grasp) for grasp in grasps]).reshape(-1, 7)
    with h5py.File(path, "w") as file:
        file.create_dataset("poses", data=poses, compression="gzip")


def grasp_from_defgraspsim(pose: np.ndarray, id: str = "") -> Grasp:
    """Convert a pose of DefGraspSim into a grasp.

    Both frames approach along +z. The original's has its origin at the base of the hand and closes along its x
    axis; ours has it between the pads and closes along y: a turn by +90 deg about z. The left finger, on the +y
    side here, is on the -x side there.

    Args:
        pose: Position x y z [m] and quaternion w x y z, scalar first, in the object frame, shape ``(7,)``.
        id: Name of the grasp.

    Raises:
        InvalidGraspError: If a number is not finite or the quaternion has not norm 1.
    """
    # Grasp itself checks the numbers, but can do so only after the conversion, which needs a unit quaternion.
    norm = float(np.linalg.norm(pose[3:]))
    if not np.isfinite(pose).all():
        raise InvalidGraspError(f"pose = {pose.tolist()} must be seven finite numbers, x y z qw qx qy qz")
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE:
        raise InvalidGraspError(f"quaternion = {pose[3:].tolist()} has norm {norm:.6g}, not 1 (order is w x y z)")
    hand = Rotation.from_quat(pose[3:], scalar_first=True)
    approach = hand.as_matrix()[:, 2]
    return Grasp(
        position=pose[:3] + load_gripper(HDF5_GRIPPER).hand_to_tcp * approach,
        orientation=(hand * TURN_TO_OUR_FRAME).as_quat(),
        id=id,
    )


def pose_of_defgraspsim(grasp: Grasp) -> np.ndarray:
    """Return a grasp as a pose of DefGraspSim, the inverse of ``grasp_from_defgraspsim``.

    The origin is the base of the Franka hand, for which the format is made, whatever the gripper is.

    Returns:
        Position x y z [m] and quaternion w x y z, scalar first, in the object frame, shape ``(7,)``.
    """
    base = grasp.position - load_gripper(HDF5_GRIPPER).hand_to_tcp * grasp.rotation[:, 2]
    hand = Rotation.from_quat(grasp.orientation) * TURN_TO_OUR_FRAME.inv()
    return np.concatenate([base, hand.as_quat(scalar_first=True)])


def _read_hdf5(path: Path) -> list[Grasp]:
    import h5py

    with h5py.File(path) as file:
        dataset = file.get("poses")
        if not isinstance(dataset, h5py.Dataset):
            raise InvalidGraspError(f"has no dataset 'poses'; found: {', '.join(file) or 'nothing'}")
        shape = dataset.shape or ()
        if len(shape) != 2 or shape[1] != 7 or dataset.dtype.kind not in "fiu":
            raise InvalidGraspError(
                f"dataset 'poses' has shape {shape} of {dataset.dtype}, expected (grasp, 7) numbers: x y z qw qx qy qz"
            )
        poses = dataset.astype(np.float64)[()]
    grasps = []
    for row, pose in enumerate(poses):
        try:
            grasps.append(grasp_from_defgraspsim(pose, id=str(row)))
        except InvalidGraspError as error:
            raise InvalidGraspError(f"row {row} of 'poses': {error}") from error
    return grasps


def _read_json(path: Path) -> list[Grasp]:
    try:
        content = json.loads(path.read_text())
    except UnicodeDecodeError as error:
        raise InvalidGraspError("is not text, so it cannot be JSON") from error
    except json.JSONDecodeError as error:
        raise InvalidGraspError(f"is not JSON: line {error.lineno}, column {error.colno}: {error.msg}") from error
    if isinstance(content, dict):
        if "grasps" not in content:
            raise InvalidGraspError(f"has no key 'grasps'; found: {', '.join(content) or 'nothing'}")
        content = content["grasps"]
    if not isinstance(content, list):
        raise InvalidGraspError(f"'grasps' is {type(content).__name__}, expected a list")
    return [_grasp_from_entry(entry, row) for row, entry in enumerate(content)]


def _grasp_from_entry(entry: object, row: int) -> Grasp:
    """Check one entry of the JSON list and make it a grasp."""
    if not isinstance(entry, dict):
        raise InvalidGraspError(
            f"grasp {row}: is {type(entry).__name__}, expected an object with {', '.join(GRASP_KEYS)}"
        )
    unknown = [key for key in entry if key not in GRASP_KEYS]
    if unknown:
        raise InvalidGraspError(f"grasp {row}: key '{unknown[0]}' is unknown; known: {', '.join(GRASP_KEYS)}")
    missing = [key for key in REQUIRED_KEYS if key not in entry]
    if missing:
        raise InvalidGraspError(f"grasp {row}: key '{missing[0]}' is missing")
    id = entry.get("id", str(row))
    if not isinstance(id, str):
        raise InvalidGraspError(f"grasp {row}: id = {id!r} must be text")
    for key in REQUIRED_KEYS:
        if not _is_number_list(entry[key]):
            raise InvalidGraspError(f"grasp {row}: {key} = {entry[key]!r} must be a list of numbers")
    try:
        return Grasp(**{**entry, "id": id})
    except InvalidGraspError as error:
        raise InvalidGraspError(f"grasp {row}: {error}") from error


def _is_number_list(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(n, (int, float)) and not isinstance(n, bool) for n in value)
