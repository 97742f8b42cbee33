"""State of a fit: the shape's parameters, and a rigid motion from its own frame to the world's."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class State:
    """Shape and pose. A point x of the shape's own frame is at `rotation @ (x - centre) + translation` in the world.

    Args:
        theta: (P,) float64 shape parameters.
        rotation: (3,3) float64 rotation matrix.
        translation: (3,) float64 [mm], where the shape's centre is in the world.
        centre: (3,) float64 [mm], the point of the shape's own frame that it turns about.
    """

    theta: Tensor
    rotation: Tensor
    translation: Tensor
    centre: Tensor

    def to_shape(self, points: Tensor) -> Tensor:
        """World points (N,3) in the shape's own frame."""
        return (points - self.translation) @ self.rotation + self.centre

    def to_world(self, points: Tensor) -> Tensor:
        """Points (N,3) of the shape's own frame in the world."""
        return (points - self.centre) @ self.rotation.T + self.translation

    def moved(self, step: Tensor) -> State:
        """After an increment (P+6,): theta, rotation vector [rad] in the shape's frame, translation [mm].

        The rotation's increment acts first: SE(3) increments on the right, so the six are never near a singularity.
        """
        count = self.theta.numel()
        turn = rotation_from_vector(step[count : count + 3])
        rotation = _orthonormal(self.rotation @ turn)
        return State(self.theta + step[:count], rotation, self.translation + step[count + 3 :], self.centre)

    def since(self, other: State) -> Tensor:
        """The increment (P+6,) from another state to this one: `other.moved(self.since(other))` is this one.

        Shapes that turn about different points are compared where the other's point is.
        """
        turn = vector_from_rotation(other.rotation.T @ self.rotation)
        translation = self.to_world(other.centre[None])[0]
        return torch.cat([self.theta - other.theta, turn, translation - other.translation])

    def chain(self, inside: Tensor, by_theta: Tensor, by_point: Tensor) -> Tensor:
        """Derivatives (N,P+6) of distances by the increment, at step 0.

        Args:
            inside: (N,3) the points in the shape's own frame.
            by_theta: (N,P) derivatives by theta.
            by_point: (N,3) derivatives by the point in the shape's own frame.
        """
        arm = inside - self.centre
        return torch.cat([by_theta, -torch.linalg.cross(arm, by_point), -by_point @ self.rotation.T], 1)


def rotation_from_vector(vector: Tensor) -> Tensor:
    """Rotation matrix (3,3) of a rotation vector (3,) [rad]."""
    return torch.linalg.matrix_exp(hat(vector))


def hat(vector: Tensor) -> Tensor:
    """The matrix (3,3) with `hat(v) @ x` = v cross x."""
    x, y, z = vector.unbind()
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)


def vector_from_rotation(rotation: Tensor) -> Tensor:
    """Rotation vector (3,) [rad] of a rotation matrix (3,3); through the unit quaternion, safe at every angle."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(rotation.detach().cpu().numpy()).as_rotvec()
    return torch.as_tensor(vector, dtype=rotation.dtype, device=rotation.device)


def _orthonormal(matrix: Tensor) -> Tensor:
    # Products of many rotations drift off the group by rounding.
    left, _, right = torch.linalg.svd(matrix)
    return left @ right
