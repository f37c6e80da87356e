"""A run as one HDF5 file: the datasets of DefGraspSim by their names and shapes, and a group of our own.

At the root are DefGraspSim's datasets: one row per grasp, nan where nothing was measured (its own files have 0 there,
so that "failed" and "zero" look alike), positions in its world: y up, the object frame's origin 1 m above the ground.
The group ``defgrasp_ros`` has everything under the names of the ROS messages, in the object frame, z up. Every dataset
says unit and meaning in its attributes; one that a log cannot fill says so, too, and takes no room.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defgrasp_ros.analysis.field_notes import field_notes
from defgrasp_ros.analysis.recorded_run import RecordedGrasp, RecordedRun
from defgrasp_ros.analysis.tables import (
    ACCELERATIONS,
    DIRECTION_COUNT,
    INTERFACES,
    TURNED,
    TURNS,
)
from defgrasp_ros.errors import RecordingError, ResultCode
from defgrasp_ros.evaluation import DeformedState, Experiment, GraspEvaluation, GraspFeatures, GraspMetrics, in_order
from defgrasp_ros.ros.result_conversion import NUMBERS

if TYPE_CHECKING:
    import h5py

GROUP = "defgrasp_ros"
PLATFORM_HEIGHT = 1.0
"""Height of the object frame's origin in DefGraspSim's world [m]."""
SQUEEZE_SAMPLES = 50
"""Forces at which DefGraspSim records the squeeze."""
COMPRESSION = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
NOT_HELD = {
    ResultCode.DROPPED,
    ResultCode.NO_CONTACT,
    ResultCode.FORCE_NOT_REACHED,
    ResultCode.GRIPPER_COLLISION,
}
"""Codes that say that a grasp does not hold."""
STAGES = {"pre_contact": "pre_contact", "at_target_force": "at_force", "post_pickup": "under_gravity"}
"""Our stages and the names that they have there."""
NO_SUCH_DATA = "not recorded by this evaluator"
BOTH_FINGERS = "mean of both fingers, in both columns"


def write_hdf5(path: Path, run: RecordedRun) -> None:
    """Write a run.

    Args:
        path: The file; replaced if it is there.
        run: The run.

    Raises:
        RecordingError: If the file cannot be written.
    """
    import h5py

    try:
        with h5py.File(path, "w") as file:
            _Writer(file, run).write()
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error


def to_world(points: np.ndarray) -> np.ndarray:
    """Return points of the object frame, z up, in DefGraspSim's world, y up [m], shape ``(..., 3)``."""
    return rotated_to_world(points) + [0.0, PLATFORM_HEIGHT, 0.0]


def rotated_to_world(vectors: np.ndarray) -> np.ndarray:
    """Return vectors of the object frame, z up, in DefGraspSim's axes, y up, shape ``(..., 3)``."""
    x, y, z = np.moveaxis(np.asarray(vectors, dtype=float), -1, 0)
    return np.stack([x, z, -y], axis=-1)


class _Writer:
    """Fills one file."""

    def __init__(self, file: h5py.File, run: RecordedRun) -> None:
        self.file, self.run, self.grasps = file, run, run.grasps
        states = [state for recorded in run.grasps for state in recorded.evaluation.fields.values()]
        mesh = run.mesh
        self.nodes = len(states[0].positions) if states else len(mesh.vertices) if mesh else 0
        self.tets = len(states[0].von_mises_stress) if states else len(mesh.tetrahedra) if mesh else 0

    def write(self) -> None:
        """Write everything."""
        self._attributes()
        self._outcomes()
        self._fields()
        self._directions()
        self._squeeze()
        self._features()
        self._own()

    # --- DefGraspSim's datasets -------------------------------------------------------------------------------------

    def _attributes(self) -> None:
        run = self.run
        self.file.attrs.update(
            {
                "description": "Run of defgrasp_ros; datasets of DefGraspSim at the root, nan: not measured",
                "object": run.object_name,
                "gripper": run.gripper.name,
                "log": run.path.name,
                "complete": run.complete,
                "frame": "world of DefGraspSim: y up; from the object frame (x y z): x, z + 1 m, -y",
                "notes": "\n".join(run.notes),
                **{f"material.{name} [{unit}]": value for name, unit, value in _material(run)},
            }
        )

    def _outcomes(self) -> None:
        success = [_success(recorded.evaluation) for recorded in self.grasps]
        self._per_grasp("grasp_index", [recorded.index for recorded in self.grasps], "-", "Row of the request")
        self._per_grasp("pickup_success", success, "-", "1: picked up and held, 0: not")
        timed_out = np.array([recorded.evaluation.code == ResultCode.TIMEOUT for recorded in self.grasps], dtype=float)
        timed_out = np.repeat(timed_out[:, None], DIRECTION_COUNT, axis=1)
        self._per_grasp("timed_out", timed_out, "-", "1: ended early by the time limit")
        energy = self._of_evaluations(lambda evaluation: evaluation.metrics.strain_energy)
        self._per_grasp("se_under_gravity", energy, "J", "Strain energy at the end of the hold, 1/2 included")
        for name in ("pre_contact_se", "se_at_force"):
            self._empty(name, (), "J", "Strain energy")
        forces = {
            "gripper_distance_at_force": ("m", lambda e: e.features.squeeze_distance, "Closed since first contact"),
            "gripper_force_at_force": ("N", lambda e: e.applied_force, "Sum of both fingers"),
            "gripper_force_under_gravity": ("N", _force_at_the_end, "Sum of both fingers at the end of the hold"),
            "initial_desired_force": ("N", lambda e: e.target_force, "Target force, sum of both fingers"),
        }
        for name, (unit, value, meaning) in forces.items():
            self._per_grasp(name, self._of_evaluations(value), unit, meaning)
        raised = self._of_evaluations(lambda e: e.reorientation.closing_force if e.reorientation else np.nan)
        raised = np.repeat(raised[:, None], DIRECTION_COUNT, axis=1)
        self._per_grasp("corrected_desired_force", raised, "N", "Force raised for the reorientation, sum of fingers")
        opening = self._of_evaluations(
            lambda e: e.fields["post_pickup"].opening if "post_pickup" in e.fields else np.nan
        )
        opening = np.repeat(opening[:, None], 2, axis=1)
        meaning = "Distance of each pad face from the grasp frame's origin; the joints there are this minus 0.004442 m"
        self._per_grasp("gripper_positions_under_gravity", opening, "m", meaning)

    def _fields(self) -> None:
        for stage, name in STAGES.items():
            prefix = stage == "pre_contact"
            stresses = self._empty(
                f"{name}_stresses" if prefix else f"stresses_{name}",
                (self.tets,),
                "Pa",
                "Von Mises stress",
                filled=True,
            )
            positions = self._empty(
                f"{name}_positions" if prefix else f"positions_{name}",
                (self.nodes, 3),
                "m",
                "Nodes, world",
                filled=True,
            )
            for row, state in self._states(stage):
                stresses[row], positions[row] = state.von_mises_stress, to_world(state.positions)
        for finger in ("left", "right"):
            for suffix in ("", "_initial"):
                self._empty(f"{finger}_contacted_nodes_under_gravity{suffix}", (self.nodes,), "-", "Mask of nodes")

    def _directions(self) -> None:
        names = {Experiment.LINEAR_ACCELERATION: "lin", Experiment.ANGULAR_ACCELERATION: "ang"}
        directions = np.full((len(self.grasps), DIRECTION_COUNT, 3), np.nan)
        for experiment, unit in ACCELERATIONS.items():
            losses = np.full((len(self.grasps), DIRECTION_COUNT), np.nan)
            for row, recorded in enumerate(self.grasps):
                if result := getattr(recorded.evaluation, experiment):
                    losses[row], directions[row] = result.at_loss, rotated_to_world(result.directions)
            meaning = "Acceleration at loss of contact; at the end of the test where contact was kept"
            self._per_grasp(f"{names[experiment]}_acc_fail_accs", losses, unit, meaning)
        shape = (DIRECTION_COUNT, len(TURNS))
        meaning = "Nodes after hand and object were turned about the object's centre of mass, world"
        meshes = self._empty("reorientation_meshes", (*shape, self.nodes, 3), "m", meaning, filled=True)
        stresses = self._empty("reorientation_stresses", (*shape, self.tets), "Pa", "Von Mises stress", filled=True)
        for row, recorded in enumerate(self.grasps):
            result = recorded.evaluation.reorientation
            if result is None:
                continue
            directions[row] = rotated_to_world(result.directions)
            for (axis, turn), state in result.states.items():
                points = self._turned(recorded, state.positions, result.directions[axis], turn)
                meshes[row, axis, turn], stresses[row, axis, turn] = to_world(points), state.von_mises_stress
        self._per_grasp("directions", directions, "-", "Unit vectors, world")

    def _turned(self, recorded: RecordedGrasp, points: np.ndarray, axis: np.ndarray, turn: int) -> np.ndarray:
        """Return the nodes of a state, known in the hand's frame, where the turned hand has them [m]."""
        from scipy.spatial.transform import Rotation

        squeezed = recorded.evaluation.fields.get("at_target_force")
        if squeezed is None or self.run.mesh is None:
            return np.full_like(points, np.nan)
        volumes = self.run.mesh.node_volumes
        centre = volumes @ squeezed.positions / volumes.sum()
        return centre + Rotation.from_rotvec(np.radians(TURNS[turn]) * axis).apply(points - centre)

    def _squeeze(self) -> None:
        results = [(row, recorded.evaluation.squeeze) for row, recorded in enumerate(self.grasps)]
        results = [(row, result) for row, result in results if result]
        samples = max([SQUEEZE_SAMPLES, *(len(result.force) for _, result in results)])
        forces = np.full((len(self.grasps), samples), np.nan)
        openings, largest = np.full((len(self.grasps), samples, 2), np.nan), np.full(len(self.grasps), np.nan)
        failed = np.full(len(self.grasps), np.nan)
        positions = self._empty("stacked_positions", (samples, self.nodes, 3), "m", "Nodes, world", filled=True)
        stresses = self._empty("stacked_stresses", (samples, self.tets), "Pa", "Von Mises stress", filled=True)
        points = [
            self._empty(
                f"stacked_{finger}_gripper_contact_points",
                (samples, self.nodes, 3),
                "m",
                "Contact points of the finger, world; the first rows, nan after them",
                filled=True,
            )
            for finger in ("left", "right")
        ]
        for row, result in results:
            count = len(result.force)
            forces[row, :count] = result.force
            openings[row, :count] = result.opening[:, None]
            reached = np.isfinite(result.opening)
            largest[row] = result.force[reached].max() if reached.any() else np.nan
            failed[row] = 0.0 if not result.reason else np.nan
            for sample, state in enumerate(result.states):
                positions[row, sample] = to_world(state.positions)
                stresses[row, sample] = state.von_mises_stress
            for sample, fingers in enumerate(result.contacts):
                for dataset, finger in zip(points, fingers, strict=True):
                    if 0 < finger.count <= self.nodes:
                        dataset[row, sample, : finger.count] = to_world(finger.positions)
        self._per_grasp("stacked_forces", forces, "N", "Sum of both fingers")
        self._per_grasp("stacked_gripper_positions", openings, "m", "Distance of each pad face from the grasp's origin")
        self._per_grasp("squeeze_no_gravity_max_force", largest, "N", "Largest force reached, sum of both fingers")
        for name in ("failed_to_increase", "lost_contact"):
            meaning = f"0: every force was reached; nan: not, {GROUP}/squeeze/reason says why"
            self._per_grasp(f"squeeze_no_gravity_{name}", failed, "-", meaning)
        self._empty("stacked_forces_on_nodes", (samples, self.nodes), "N", "Normal force of each node")
        for finger in ("left", "right"):
            self._empty(f"stacked_{finger}_node_contacts", (samples, self.nodes, 6), "-", "Nodes and weights")

    def _features(self) -> None:
        names = {
            "pure_distances": ("m", "contact_patch_distance"),
            "perp_distances": ("m", "contact_patch_perpendicular_distance"),
            "edge_distances": ("m", "edge_distance"),
            "num_gripper_contacts": ("-", "contact_count"),
        }
        for name, (unit, feature) in names.items():
            values = self._of_evaluations(lambda evaluation, feature=feature: getattr(evaluation.features, feature))
            meaning = f"{field_notes(f'{INTERFACES}/GraspFeatures')[feature].meaning} {BOTH_FINGERS}"
            self._per_grasp(name, np.repeat(values[:, None], 2, axis=1), unit, meaning)

    # --- our own group ----------------------------------------------------------------------------------------------

    def _own(self) -> None:
        group = self.file.create_group(GROUP)
        group.attrs["frame"] = "object frame: that of the mesh vertices, z up; quaternions x y z w"
        group.attrs.update({f"provenance.{name}": text for name, text in self.run.provenance.items()})
        options = {**dataclasses.asdict(self.run.options), "experiments": in_order(self.run.options.experiments)}
        group.attrs.update({f"options.{name}": _plain(value) for name, value in options.items()})
        self._own_numbers(group)
        self._own_mesh(group)
        for experiment, unit in ACCELERATIONS.items():
            self._own_acceleration(group, experiment, unit)
        self._own_reorientation(group)
        self._own_squeeze(group)
        self._own_series(group)

    def _own_numbers(self, group: h5py.Group) -> None:
        evaluations = [recorded.evaluation for recorded in self.grasps]
        _text(group, "grasp_id", [recorded.id for recorded in self.grasps], "Name of the grasp")
        _text(group, "outcome", [evaluation.code.name for evaluation in evaluations], "Result code")
        _text(group, "message", [evaluation.message for evaluation in evaluations], "Why it failed, in words")
        _put(group, "code", [int(evaluation.code) for evaluation in evaluations], "", "Number of the result code")
        poses = [_pose(recorded) for recorded in self.grasps]
        _put(group, "grasp_pose", poses, "m, -", "Grasp frame: position x y z, orientation x y z w")
        for message, names, source in (
            ("GraspEvaluation", NUMBERS, lambda evaluation: evaluation),
            ("GraspMetrics", _names(GraspMetrics), lambda evaluation: evaluation.metrics),
            ("GraspFeatures", _names(GraspFeatures), lambda evaluation: evaluation.features),
        ):
            notes = field_notes(f"{INTERFACES}/{message}")
            for name in names:
                values = self._of_evaluations(
                    lambda evaluation, name=name, source=source: getattr(source(evaluation), name)
                )
                _put(group, name, values, notes[name].unit, notes[name].meaning)

    def _own_mesh(self, group: h5py.Group) -> None:
        mesh = self.run.mesh
        if mesh is not None:
            group.attrs["element_order"] = mesh.element_order
            _put(group, "mesh/vertices", mesh.vertices, "m", "Nodes at rest")
            _put(group, "mesh/tetrahedra", mesh.tetrahedra, "-", "Corners of each tetrahedron", dtype="i4")

    def _own_acceleration(self, group: h5py.Group, experiment: Experiment, unit: str) -> None:
        results = [getattr(recorded.evaluation, experiment) for recorded in self.grasps]
        if not any(results):
            return
        notes = field_notes(f"{INTERFACES}/AccelerationResult")
        blank = np.full(DIRECTION_COUNT, np.nan)
        for name in ("at_loss", "at_slip", "is_lower_bound"):
            values = [np.asarray(getattr(result, name), dtype=float) if result else blank for result in results]
            number_unit = "-" if name == "is_lower_bound" else unit
            _put(group, f"{experiment}/{name}", values, number_unit, notes[name].meaning)
        blank = np.full((DIRECTION_COUNT, 3), np.nan)
        directions = [result.directions if result else blank for result in results]
        _put(group, f"{experiment}/directions", directions, "-", notes["directions"].meaning)
        reasons = [result.reasons if result else [""] * DIRECTION_COUNT for result in results]
        _text(group, f"{experiment}/reasons", reasons, notes["reasons"].meaning)

    def _own_reorientation(self, group: h5py.Group) -> None:
        results = [recorded.evaluation.reorientation for recorded in self.grasps]
        if not any(results):
            return
        blank = np.full((DIRECTION_COUNT, len(TURNS)), np.nan)
        notes = field_notes(f"{INTERFACES}/ReorientationResult")
        for name, unit in TURNED.items():
            values = [getattr(result, name) if result else blank for result in results]
            _put(group, f"reorientation/{name}", values, unit, notes[name].meaning)
        reasons = [result.reasons if result else [""] * DIRECTION_COUNT for result in results]
        _text(group, "reorientation/reasons", reasons, notes["reasons"].meaning)

    def _own_squeeze(self, group: h5py.Group) -> None:
        results = [recorded.evaluation.squeeze for recorded in self.grasps]
        if not any(results):
            return
        notes = field_notes(f"{INTERFACES}/SqueezeResult")
        samples = max(len(result.force) for result in results if result)
        for name in ("force", "opening", "max_deformation", "max_von_mises_stress", "strain_energy"):
            values = np.full((len(results), samples), np.nan)
            for row, result in enumerate(results):
                if result:
                    values[row, : len(result.force)] = getattr(result, name)
            _put(group, f"squeeze/{name}", values, notes[name].unit, notes[name].meaning)
        reasons = [result.reason if result else "" for result in results]
        _text(group, "squeeze/reason", reasons, notes["reason"].meaning)

    def _own_series(self, group: h5py.Group) -> None:
        notes = field_notes(f"{INTERFACES}/PickupCourse")
        for recorded in self.grasps:
            for kind, origin in (("samples", "the start of the run"), ("pickup", "the start of the squeeze")):
                series = getattr(recorded, kind)
                if series is None or not len(series.time):
                    continue
                place = f"{kind}/{recorded.index}"
                _put(group, f"{place}/time", series.time, "s", f"Simulated time since {origin}")
                for name, values in series.values.items():
                    if series.has(name):
                        _put(group, f"{place}/{name}", values, notes[name].unit, notes[name].meaning)

    # --- helpers ----------------------------------------------------------------------------------------------------

    def _states(self, stage: str) -> list[tuple[int, DeformedState]]:
        states = [(row, recorded.evaluation.fields.get(stage)) for row, recorded in enumerate(self.grasps)]
        return [(row, state) for row, state in states if state is not None]

    def _of_evaluations(self, value) -> np.ndarray:
        """Return a number of every evaluation that is finished, nan for the others."""
        return np.array([float(value(each.evaluation)) if each.finished else np.nan for each in self.grasps])

    def _per_grasp(self, name: str, values: Any, unit: str, meaning: str) -> None:
        _put(self.file, name, values, unit, meaning, dtype="f4")

    def _empty(
        self, name: str, shape: tuple[int, ...], unit: str, meaning: str, *, filled: bool = False
    ) -> h5py.Dataset:
        """Make a dataset of nan, to be ``filled`` by the caller or left so."""
        # One grasp per chunk, of fields one state per chunk: what is never written takes no room.
        whole = shape[-2:] if len(shape) > 1 and shape[-1] == 3 else shape[-1:]
        chunk = (1,) * (1 + len(shape) - len(whole)) + whole if all(shape) else None
        full = (len(self.grasps), *shape)
        options = {"chunks": chunk, **COMPRESSION} if chunk and all(full) else {}
        dataset = self.file.create_dataset(name, full, "f4", fillvalue=np.nan, **options)
        _describe(dataset, unit, meaning if filled else f"{meaning}; {NO_SUCH_DATA}")
        return dataset


def _put(group: h5py.Group, name: str, values: Any, unit: str, meaning: str, dtype: str = "f8") -> None:
    array = np.asarray(values, dtype=dtype)
    _describe(group.create_dataset(name, data=array, **(COMPRESSION if array.size > 1 else {})), unit, meaning)


def _text(group: h5py.Group, name: str, values: Any, meaning: str) -> None:
    import h5py

    _describe(group.create_dataset(name, data=np.array(values, dtype=object), dtype=h5py.string_dtype()), "", meaning)


def _describe(dataset: h5py.Dataset, unit: str, meaning: str) -> None:
    dataset.attrs["unit"], dataset.attrs["meaning"] = unit, meaning


def _success(evaluation: GraspEvaluation) -> float:
    """Return 1 where the object was held, 0 where it was not, nan where that is not known."""
    if evaluation.metrics.pickup_success:
        return 1.0  # also if the run was stopped in a later experiment
    return 0.0 if evaluation.code in NOT_HELD else np.nan


def _force_at_the_end(evaluation) -> float:
    if not evaluation.metrics.pickup_success or not evaluation.contacts:
        return np.nan
    return sum(finger.normal_force for finger in evaluation.contacts)


def _pose(recorded: RecordedGrasp) -> np.ndarray:
    if recorded.grasp is None:
        return np.full(7, np.nan)
    return np.concatenate([recorded.grasp.position, recorded.grasp.orientation])


def _names(part: type) -> list[str]:
    return [each.name for each in dataclasses.fields(part)]


def _material(run: RecordedRun) -> list[tuple[str, str, float]]:
    notes = field_notes(f"{INTERFACES}/Material")
    return [(name, notes[name].unit, value) for name, value in dataclasses.asdict(run.material).items()]


def _plain(value: Any) -> Any:
    return ",".join(value) if isinstance(value, (list, tuple)) else value
