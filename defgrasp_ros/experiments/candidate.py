"""One grasp on its way through the experiment: what was asked, what is known, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from defgrasp_ros.errors import ResultCode
from defgrasp_ros.evaluation import FINGER_NAMES, NAN, FingerContact, GraspEvaluation, Phase
from defgrasp_ros.experiments.pickup_recorder import PickupRecorder
from defgrasp_ros.grasp import Grasp
from defgrasp_ros.simulation.shard import WorldSnapshot
from defgrasp_ros.simulation.stepper import StepReport

TOUCHING_SHARE = 1e-4
"""Normal force, relative to the target force, above which a body touches [-]; far above the solver's residual."""


@dataclass(eq=False)
class Candidate:
    """A grasp, its evaluation so far, and what the phases have to remember of it."""

    grasp: Grasp
    """Pose on the settled object."""
    target_force: float
    """SUM of the two pad normal forces asked for [N]."""
    evaluation: GraspEvaluation
    platform_height: float
    """Surface of its platform [m]."""
    phase: Phase = Phase.SQUEEZE
    finished: bool = False
    """Whether its pickup has ended."""
    reported: bool = False
    """Whether the observer knows its evaluation."""
    at_contact: WorldSnapshot | None = None
    """Its world when the first pad touches the settled object."""
    squeezed: WorldSnapshot | None = None
    """Its world at the target force, still on the platform."""
    squeezed_contacts: tuple[FingerContact, FingerContact] | None = None
    """What the fingers felt there."""
    remark: str = ""
    """Added to the message of a grasp that holds."""
    course: PickupRecorder = field(default_factory=PickupRecorder)
    """Its pickup so far."""
    time: float = 0.0
    """Since the start of the squeeze [s]."""
    lowering_began: float = NAN
    """When its platform began to sink, of the same clock [s]."""
    opening_at_contact: float = NAN
    """Opening at which pads that close one by one just touch the settled object, mean of both [m]."""
    was_gripped: bool = False
    """Whether both fingers have touched."""
    holding_time: float = 0.0
    """Since the platform let go [s]."""
    time_without_contact: float = 0.0
    """Since a finger lost the object [s]."""
    time_at_rest: float = 0.0
    """Since everything became slow [s]."""
    gripped_nodes: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    """Nodes under the pads at the target force."""
    gripped_positions: np.ndarray | None = None
    """Where they were then [m]."""
    lifted_positions: np.ndarray | None = None
    """Where they were when the platform had gone [m]."""

    def end(self, code: ResultCode, message: str) -> None:
        """Set how the evaluation ended."""
        self.evaluation.code, self.evaluation.message = code, message
        self.finished = True

    @property
    def touching_force(self) -> float:
        """Normal force above which a body touches [N]."""
        return TOUCHING_SHARE * self.target_force

    def touching(self, normal_forces: np.ndarray) -> np.ndarray:
        """Return which bodies with these normal forces [N] touch the object."""
        return normal_forces > self.touching_force

    @property
    def picked_up(self) -> bool:
        """Whether the pickup has succeeded."""
        return self.evaluation.metrics.pickup_success

    def slip(self, positions: np.ndarray, reference: np.ndarray | None) -> float:
        """Return how far the gripped nodes moved along the pads, mean [m]; nan without a reference.

        Args:
            positions: All nodes [m], shape ``(node, 3)``.
            reference: Where the gripped nodes were [m].
        """
        if reference is None:
            return NAN
        axis, shift = self.grasp.rotation[:, 1], positions[self.gripped_nodes] - reference
        return float(np.linalg.norm(shift - (shift @ axis)[:, None] * axis, axis=1).mean())

    def count_step(self, report: StepReport, row: int, h: float) -> None:
        """Add a step of length h [s], in whichever of its worlds, to the account."""
        self.evaluation.simulated_time += h
        solver = self.evaluation.solver
        solver.iterations += int(report.iterations[row])
        solver.step_cuts += int(report.cuts[row])
        solver.contact_fallbacks += int(report.contact_fallbacks[row])
        solver.converged &= bool(report.converged[row])
        if report.converged[row]:
            solver.steps += 1
            solver.residual = max(solver.residual, float(report.residual[row]))
        else:
            solver.residual = float(report.residual[row])

    def squeeze_failure(self, pads: np.ndarray, platform: float, opening: float) -> tuple[ResultCode, str]:
        """Return why the target force was not reached.

        Args:
            pads: Normal forces of the pads [N], shape ``(2,)``.
            platform: Normal force of the platform [N].
            opening: Distance of each pad face from the grasp frame's origin [m].
        """
        if opening <= 0.0 and not self.was_gripped:
            return ResultCode.NO_CONTACT, "the pads met without both having touched the object"
        if opening <= 0.0:
            return ResultCode.FORCE_NOT_REACHED, "the object was squeezed out from between the pads"
        touched = [name for name, touches in zip(FINGER_NAMES, self.touching(pads), strict=True) if touches]
        if len(touched) == len(FINGER_NAMES):
            text = f"the pads reached {pads.sum():.4g} N of the {self.target_force:.4g} N asked for"
            return ResultCode.FORCE_NOT_REACHED, text
        only = f"only the {spoken(touched[0])} touches" if touched else "no finger touches"
        text = f"{only}: the object does not move up to the other one (platform force {platform:.3g} N)"
        return ResultCode.NO_CONTACT, text


def spoken(part: str) -> str:
    """Return the name of a part of the gripper as in a sentence."""
    return part.replace("_", " ")
