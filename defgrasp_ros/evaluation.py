"""What an evaluation is asked for and what it answers: plain data, without simulator and without ROS.

Units are SI. ``nan`` means "not measured", and the result's text says why; a number is never made up.
Names are those of the messages in ``defgrasp_interfaces``; the paper's short names stand in brackets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum

import numpy as np

from defgrasp_ros.errors import InvalidOptionsError, ResultCode
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.option import option, options_of

FINGER_NAMES = ("left_finger", "right_finger")
"""The two fingers in the order of every per-finger array; left is on the +y side of the grasp frame."""

NAN = math.nan


class Experiment(StrEnum):
    """What can be done with a grasp. The pickup always comes first; the others need an object that was picked up,
    but for the squeeze."""

    PICKUP = "pickup"
    REORIENTATION = "reorientation"
    LINEAR_ACCELERATION = "linear_acceleration"
    ANGULAR_ACCELERATION = "angular_acceleration"
    SQUEEZE = "squeeze"


ALL_EXPERIMENTS = "all"
"""Stands for every experiment in a list of names."""


def in_order(experiments: Iterable[Experiment]) -> list[Experiment]:
    """Return experiments in the order in which they are done."""
    return sorted(experiments, key=list(Experiment).index)


@dataclass(frozen=True)
class EvaluationOptions:
    """What is done with each grasp, and the constants of the protocol; the defaults are the paper's.

    ``experiments`` takes names, too, also in one text with commas, and ``"all"``; the pickup is part of every
    evaluation, named or not.

    Raises:
        InvalidOptionsError: If a value is outside its range, or an experiment is unknown.
    """

    experiments: frozenset[Experiment] = frozenset({Experiment.PICKUP})
    force_safety_factor: float = option(
        1.3, "Default target force of a grasp is this x m g / friction coefficient", "-", 0.0, 1e3, low_open=True
    )
    pickup_hold_time: float = option(
        5.0, "How long both fingers must keep contact after the platform has gone", "s", 0.0, 600.0
    )
    platform_speed: float = option(0.08, "Speed with which the platform sinks", "m/s", 1e-4, 1.0)
    squeeze_time: float = option(0.2, "Duration of a force ramp, from 0 to the target force", "s", 0.01, 60.0)
    time_step: float = option(
        1.0 / 200.0, "Time step; one that does not converge is repeated in smaller ones", "s", 1e-5, 0.02
    )
    slip_force_limit: float = option(
        10.0, "Reorientation: the raised force is at most this x target force", "-", 1.0, 1e3
    )
    reorientation_speed: float = option(3.0, "Reorientation: speed with which the hand is turned", "rad/s", 0.01, 30.0)
    reorientation_settles: bool = option(
        True, "Reorientation: each state comes to rest before it is recorded; else it is a snapshot in motion"
    )
    linear_jerk: float = option(1000.0, "Linear acceleration: rate at which it grows", "m/s^3", 1.0, 1e5)
    max_linear_acceleration: float = option(
        50.0, "Linear acceleration: largest value, where the test ends", "m/s^2", 0.1, 1e4
    )
    angular_jerk: float = option(2500.0, "Angular acceleration: rate at which it grows", "rad/s^3", 1.0, 1e6)
    max_angular_acceleration: float = option(
        1000.0, "Angular acceleration: largest value, where the test ends", "rad/s^2", 0.1, 1e5
    )
    acceleration_time_step: float = option(1.0 / 1000.0, "Time step of both acceleration tests", "s", 1e-5, 0.01)
    squeeze_force: float = option(
        15.0, "Squeeze without gravity: largest sum of both pad forces", "N", 0.0, 1e4, low_open=True
    )
    squeeze_force_near_rigid: float = option(
        30.0, "The same for a Young's modulus above 1e8 Pa", "N", 0.0, 1e4, low_open=True
    )
    squeeze_sample_count: int = option(
        50, "Squeeze without gravity: number of forces at which it is recorded", "-", 1, 1000
    )
    return_fields: bool = False
    """Whether nodal positions and element stresses are kept in the results; observers can have them without that."""

    def __post_init__(self) -> None:
        for name, described in options_of(type(self)).items():
            value = described.checked(InvalidOptionsError, f"options.{name}", getattr(self, name))
            object.__setattr__(self, name, value)
        object.__setattr__(self, "experiments", self._known_experiments())

    def _known_experiments(self) -> frozenset[Experiment]:
        """Return the experiments as such, with the pickup among them."""
        names = self.experiments.split(",") if isinstance(self.experiments, str) else self.experiments
        if not isinstance(names, Collection) or not all(isinstance(name, str) for name in names):
            raise InvalidOptionsError(f"options.experiments = {names!r} is no list of names")
        unknown = sorted(set(names) - {*Experiment, ALL_EXPERIMENTS})
        if unknown:
            known = ", ".join((*Experiment, ALL_EXPERIMENTS))
            raise InvalidOptionsError(f"options.experiments: '{unknown[0]}' is unknown; known are {known}")
        return frozenset(Experiment if ALL_EXPERIMENTS in names else map(Experiment, {Experiment.PICKUP, *names}))


class Phase(IntEnum):
    """Where in the protocol an evaluation is (mirrors ``defgrasp_interfaces/msg/EvaluatorStatus``)."""

    PREPARE = 0
    SETTLE = 1
    CLOSE = 2
    SQUEEZE = 3
    LOWER_PLATFORM = 4
    HOLD = 5
    DONE = 6
    REORIENT = 7
    ACCELERATE = 8
    SQUEEZE_FREE = 9


@dataclass
class GraspFeatures:
    """The seven grasp features, measured at the target force, before lifting (mean over the two fingers)."""

    contact_patch_distance: float = NAN
    """Distance from contact patch to the object's centroid [m] (pure_dist)."""
    contact_patch_perpendicular_distance: float = NAN
    """The same, in the plane across the closing axis [m] (perp_dist)."""
    contact_count: float = NAN
    """Contact points per finger [-] (num_contacts)."""
    edge_distance: float = NAN
    """Distance from contact patch to the distal edge of the pad [m] (edge_dist)."""
    squeeze_distance: float = NAN
    """How far the gap between the pads closed from first contact to the target force [m] (squeeze_dist)."""
    gripper_separation: float = NAN
    """Gap between the pad faces at the target force [m] (gripper_sep)."""
    gravity_alignment: float = NAN
    """Angle between closing axis and vertical, in [0, pi/2] [rad] (grav_align)."""


@dataclass
class GraspMetrics:
    """The seven performance metrics; numbers are ``nan`` where the object was not held."""

    pickup_success: bool = False
    """Whether both fingers kept contact for the hold time after the platform had gone."""
    max_von_mises_stress: float = NAN
    """Largest element von Mises stress at the end of the hold [Pa]."""
    max_deformation: float = NAN
    """Largest nodal displacement from the pre-contact shape, rigid motion removed [m]."""
    strain_energy: float = NAN
    """1/2 sum V sigma : epsilon at the end of the hold [J] (the paper writes it without the 1/2)."""
    linear_instability: float = NAN
    """Acceleration at which a finger loses contact, mean over 16 directions [m/s^2]; larger is more stable."""
    angular_instability: float = NAN
    """The same for the angular acceleration about 16 axes [rad/s^2]."""
    deformation_controllability: float = NAN
    """Largest ``max_deformation`` over the 64 states of the reorientation [m]."""


@dataclass
class FingerContact:
    """What one finger feels at one instant; vectors in the object frame.

    ``positions`` [m], ``normals`` (unit, into the object) and ``forces`` [N] (on the object) have shape
    ``(contact, 3)`` and hold the contact points that carry force.
    """

    name: str
    positions: np.ndarray
    normals: np.ndarray
    forces: np.ndarray
    slipping: bool = False
    """Whether the object slides on this finger as a whole: the resistance of its patch is used up."""

    @property
    def count(self) -> int:
        """Number of contact points that carry force."""
        return len(self.positions)

    @property
    def normal_forces(self) -> np.ndarray:
        """Normal force of each contact point [N], shape ``(contact,)``, positive."""
        return np.einsum("ij,ij->i", self.forces, self.normals)

    @property
    def normal_force(self) -> float:
        """Sum of the normal forces [N]."""
        return float(self.normal_forces.sum())

    @property
    def tangential_force(self) -> np.ndarray:
        """Friction force of the finger on the object [N], shape ``(3,)``."""
        return (self.forces - self.normal_forces[:, None] * self.normals).sum(axis=0)

    @property
    def centroid(self) -> np.ndarray:
        """Mean position of the contact points [m], shape ``(3,)``; nan without contact."""
        return self.positions.mean(axis=0) if self.count else np.full(3, NAN)


@dataclass
class SolverReport:
    """How well the time steps of one evaluation were solved."""

    converged: bool = True
    """Whether no step was given up."""
    steps: int = 0
    """Accepted time steps [-]."""
    iterations: int = 0
    """Quasi-Newton iterations, all steps together [-]."""
    residual: float = 0.0
    """Largest residual of an accepted step, relative to the force scale [-]."""
    step_cuts: int = 0
    """Steps that were repeated with smaller ones [-]."""
    contact_fallbacks: int = 0
    """Contact problems that the first method did not solve [-]."""


@dataclass
class DeformedState:
    """Fields over the mesh at one instant."""

    positions: np.ndarray
    """Nodes in the object frame [m], shape ``(node, 3)``."""
    von_mises_stress: np.ndarray
    """Per element, the largest of its stress points [Pa], shape ``(tet,)``; one point at order 1, four at order 2."""
    opening: float = NAN
    """Distance of each pad face from the grasp frame's origin [m]; nan before the gripper is there."""

    def in_single_precision(self) -> DeformedState:
        """Return a copy that takes half the room, as messages hold it; there can be over a hundred per grasp."""
        return replace(
            self,
            positions=self.positions.astype(np.float32),
            von_mises_stress=self.von_mises_stress.astype(np.float32),
        )


@dataclass
class PickupCourse:
    """The pickup over time, from the start of the squeeze to the end of the hold or the loss; shape ``(sample,)`` each.

    Sampled at the default ``EvaluationObserver.sample_interval``, whatever the observer wants.
    """

    time: np.ndarray
    """Since the start of the squeeze [s]."""
    phase: np.ndarray
    """Values of :class:`Phase`: SQUEEZE, LOWER_PLATFORM, HOLD."""
    opening: np.ndarray
    """Distance of each pad face from the grasp frame's origin [m]."""
    left_normal_force: np.ndarray
    """Sum of the normal forces of the left pad [N]."""
    right_normal_force: np.ndarray
    """The same of the right pad [N]."""
    platform_force: np.ndarray
    """Normal force of the platform [N]."""
    slip: np.ndarray
    """How far the gripped nodes moved along the pads since the target force was reached, mean [m]; nan before."""
    max_von_mises_stress: np.ndarray
    """Largest von Mises stress [Pa]."""


@dataclass
class AccelerationResult:
    """How a grasp did in the linear or the angular acceleration test; one entry per direction, shape ``(16,)``."""

    directions: np.ndarray
    """Unit vectors in the object frame, shape ``(16, 3)``."""
    at_loss: np.ndarray
    """Acceleration at which a finger lost contact [m/s^2 or rad/s^2]; nan where the reason says why."""
    at_slip: np.ndarray
    """Acceleration at which the object began to slide on both fingers as a whole [m/s^2 or rad/s^2]; nan where it did
    not before the loss or the end."""
    is_lower_bound: np.ndarray
    """Whether contact was kept up to the end of the test, or until the object was crushed or torn; ``at_loss`` is the
    acceleration reached by then."""
    reasons: list[str]
    """Why there is no number; empty where there is one."""

    @property
    def instability(self) -> float:
        """Mean over the directions [m/s^2 or rad/s^2]; nan where one of them has no number."""
        return float(self.at_loss.mean())


@dataclass
class ReorientationResult:
    """The states of the reorientation: 16 axes x turns of 45, 90, 135 and 180 degrees; shape ``(16, 4)`` each.

    nan where the object was dropped before, or no solution was found; the reason of the axis says so.
    """

    directions: np.ndarray
    """Axes of the turns, unit vectors in the object frame, shape ``(16, 3)``."""
    closing_force: float
    """SUM of the two pad normal forces with which the object was grasped [N]."""
    max_deformation: np.ndarray
    """Largest nodal displacement from the pre-contact shape, rigid motion removed [m]."""
    max_deformation_from_lifted: np.ndarray
    """The same from the shape in which it hung before the first turn [m]."""
    max_von_mises_stress: np.ndarray
    """[Pa]."""
    strain_energy: np.ndarray
    """[J]."""
    reasons: list[str]
    """Why an axis has states without numbers; empty where all were reached, shape ``(16,)``."""
    states: dict[tuple[int, int], DeformedState] = field(default_factory=dict)
    """Fields by axis and turn, in single precision; empty where nobody wants fields."""

    @property
    def controllability(self) -> float:
        """Largest deformation over all states [m]; nan where a state was not reached."""
        return float(self.max_deformation.max())


@dataclass
class SqueezeResult:
    """The squeeze without gravity, at evenly spaced forces; shape ``(sample,)`` each, nan from where it failed."""

    force: np.ndarray
    """SUM of the two pad normal forces [N]."""
    opening: np.ndarray
    """Distance of each pad face from the grasp frame's origin [m]."""
    max_deformation: np.ndarray
    """Largest nodal displacement from the shape before contact, rigid motion removed [m]."""
    max_von_mises_stress: np.ndarray
    """[Pa]."""
    strain_energy: np.ndarray
    """[J]."""
    contacts: list[tuple[FingerContact, FingerContact]] = field(default_factory=list)
    states: list[DeformedState] = field(default_factory=list)
    """Fields by force, in single precision; empty where nobody wants fields."""
    reason: str = ""
    """Why it ended early; empty where it did not."""


@dataclass
class GraspEvaluation:
    """Everything known about one grasp after its evaluation."""

    grasp_index: int
    grasp_id: str
    code: ResultCode = ResultCode.OK
    message: str = ""
    features: GraspFeatures = field(default_factory=GraspFeatures)
    metrics: GraspMetrics = field(default_factory=GraspMetrics)
    target_force: float = NAN
    """SUM of the two pad normal forces asked for [N]."""
    applied_force: float = NAN
    """The same, as measured when the features were taken [N]."""
    contacts: tuple[FingerContact, FingerContact] | None = None
    """Left and right finger at the end of the hold, or at the target force where the hold failed; None before that."""
    palm_force: np.ndarray = field(default_factory=lambda: np.full(3, NAN))
    """Force of the palm on the object at the instant of ``contacts`` [N], object frame, shape ``(3,)``; 0 where it does
    not touch."""
    slip_distance: float = NAN
    """How far the gripped nodes moved along the pads while the object was held, mean [m]: from the moment the platform
    had gone to the end of the hold, or to the loss."""
    holding_time: float = NAN
    """How long both fingers kept contact after the platform had gone [s]; the hold time where all came to rest."""
    loss_of_contact_time: float = NAN
    """From the moment the platform began to sink until a finger lost contact for good [s]; nan: not lost."""
    stress_error: float = NAN
    """Estimate of the discretisation error of the stress at the end of the hold [Pa]: the uniaxial stress whose energy,
    all over the object, is that of the error."""
    deformation_error: float = NAN
    """Estimate of the discretisation error of ``metrics.max_deformation`` [m]."""
    simulated_time: float = 0.0
    """Of this grasp, all experiments and directions together [s], without the settling that all grasps share."""
    end_time: float = 0.0
    """Simulated time of the run when all about the grasp was known [s]; its message has it in the stamp only."""
    wall_time: float = 0.0
    """Time [s] until this grasp's evaluation ended; grasps of a batch share it."""
    solver: SolverReport = field(default_factory=SolverReport)
    pickup: PickupCourse | None = None
    """None where the pads closed on nothing."""
    reorientation: ReorientationResult | None = None
    """None where the experiment was not asked for, or not begun since the object was not picked up."""
    linear_acceleration: AccelerationResult | None = None
    angular_acceleration: AccelerationResult | None = None
    squeeze: SqueezeResult | None = None
    fields: dict[str, DeformedState] = field(default_factory=dict)
    """By stage: ``pre_contact``, ``at_target_force``, ``post_pickup``; empty where nobody wants fields."""

    def without_fields(self) -> GraspEvaluation:
        """Return the same without anything over the mesh."""
        return replace(
            self,
            fields={},
            reorientation=self.reorientation and replace(self.reorientation, states={}),
            squeeze=self.squeeze and replace(self.squeeze, states=[]),
        )


@dataclass
class NodalFields:
    """Shape and stress at one instant, one value per node of the mesh."""

    positions: np.ndarray
    """In the object frame [m], shape ``(node, 3)``."""
    displacement: np.ndarray
    """Distance from the pre-contact shape, rigid motion removed [m], shape ``(node,)``; its largest value is what
    ``max_deformation`` measures."""
    von_mises_stress: np.ndarray
    """Mean of the adjacent elements, weighted by volume [Pa], shape ``(node,)``."""


@dataclass
class GraspSample:
    """The state of one running grasp, as published and recorded while the simulation runs."""

    grasp_index: int
    grasp_id: str
    grasp: Grasp
    """Where the hand is, on the settled object."""
    experiment: Experiment
    direction: int | None
    """Which of the directions this is, of an experiment that has several; else None."""
    phase: Phase
    time: float
    """Simulated time since the start of the run [s]."""
    opening: float
    """Distance of each pad face from the grasp frame's origin [m]."""
    opening_velocity: float
    """Rate of the opening [m/s], negative when closing."""
    closing_force: float
    """Force with which the drive closes the pair of fingers [N], sum of both."""
    contacts: tuple[FingerContact, FingerContact]
    palm: FingerContact
    """What the palm feels."""
    platform_force: float
    """Normal force of the platform on the object [N]."""
    platform_height: float
    """Surface of the platform [m]; nan once it is gone."""
    read_fields: Callable[[], NodalFields]
    """Reads shape and stress from the simulator; only while the observer is being told of the sample."""

    @property
    def palm_force(self) -> np.ndarray:
        """Force of the palm on the object [N], shape ``(3,)``."""
        return self.palm.forces.sum(axis=0)


@dataclass
class Progress:
    """How far the run is; ``fraction`` is an estimate in [0, 1]."""

    phase: Phase
    fraction: float
    simulated_time: float
    active_grasps: int
    grasp_count: int


class EvaluationObserver:
    """Follows a running evaluation; override what you need. Called in the thread that simulates.

    ``sample_interval`` is the simulated time between two calls of ``on_samples`` [s]; ``sample_direction`` says which
    direction is sampled in experiments that try each grasp in several at once.
    """

    sample_interval = 0.02
    sample_direction = 0

    def on_progress(self, progress: Progress) -> None:
        """The run got further."""

    def wants_samples(self) -> bool:
        """Whether ``on_samples`` has a use for the present state; reading it from the simulator costs time."""
        return True

    def on_samples(self, samples: Sequence[GraspSample]) -> None:
        """The present state of every grasp that is being simulated, at least one, in the order of the grasps."""

    def wants_fields(self) -> bool:
        """Whether the evaluations told here have fields over the mesh, although the options do not ask for them; kept
        until then for the grasps of a batch, but not longer."""
        return False

    def on_evaluation(self, evaluation: GraspEvaluation) -> None:
        """One grasp is finished."""

    def should_stop(self) -> bool:
        """Whether the run is canceled; grasps not finished come back with code CANCELED."""
        return False
