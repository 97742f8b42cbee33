"""Result of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.errors import SDMError
from sdm.fit.model.appearance import Appearance
from sdm.fit.model.pose import State
from sdm.fit.solve.diagnosis import Diagnosis
from sdm.fit.solve.posterior import Posterior
from sdm.inspect.facts_table import facts_table
from sdm.io.files.json_file import write_json
from sdm.shapes import Parameter

POSE_NAMES = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z")


class FitError(SDMError):
    """An image that gives no answer to be trusted."""


@dataclass(frozen=True, eq=False)
class Formation:
    """Formation of an image, as it was estimated with the shape.

    Args:
        blur: The scanner's blur and its standard deviation.
        effective_share: Independent voxels for each voxel, by the noise's correlation; 1 for white noise.
        coefficients: (2F,) of the polynomials of the intensities, inside and outside.
        expected: (nx,ny,nz) expected image.
        p_value: Of the posterior predictive check of residuals at the surface.
        unexplained: Residuals at the surface beyond the noise, root mean square, as a share of the contrast.
    """

    blur: tuple[float, float]
    effective_share: float
    coefficients: Tensor
    expected: Tensor
    p_value: float
    unexplained: float

    def record(self) -> dict[str, Any]:
        """Everything but the image as plain numbers, for JSON."""
        return {
            "effective_share_of_voxels": self.effective_share,
            "intensity_coefficients": self.coefficients.tolist(),
            "p_value": self.p_value,
            "unexplained_share_of_contrast": self.unexplained,
        }


@dataclass(frozen=True, eq=False)
class FitResult:
    """An estimate with its uncertainty, and whether to believe it.

    Args:
        parameters: The shape parameters, in the order of theta.
        posterior: The Laplace approximation about the estimate.
        appearance: Intensities inside and outside.
        share: (nx,ny,nz) expected share of inside of each voxel.
        objective: Minus the log posterior density at the estimate, but for a constant.
        diagnosis: Convergence, and whether there is such a shape in the image.
        evaluations: Shapes built, by backend.
        steps: Steps of shape and pose, by stage.
        seconds: Wall time.
        blur: Estimate of the scanner's blur and its standard deviation, where it was estimated with the shape.
        formation: The image's formation, where it was estimated with the shape.
    """

    parameters: tuple[Parameter, ...]
    posterior: Posterior
    appearance: Appearance
    share: Tensor
    objective: float
    diagnosis: Diagnosis
    evaluations: dict[str, int]
    steps: dict[str, int]
    seconds: float
    blur: tuple[float, float] | None = None
    formation: Formation | None = None

    @property
    def expected(self) -> Tensor:
        """(nx,ny,nz) expected image; the image less this is the residual map."""
        if self.formation is not None:
            return self.formation.expected
        return self.share * self.appearance.inside.mean + (1 - self.share) * self.appearance.outside.mean

    @property
    def state(self) -> State:
        """The estimated shape and pose."""
        return self.posterior.state

    @property
    def trusted(self) -> bool:
        """True if nothing speaks against the answer."""
        return self.diagnosis.trusted

    def require(self) -> FitResult:
        """This result, if it is to be trusted.

        Raises:
            FitError: Says what speaks against it.
        """
        if not self.trusted:
            raise FitError("the fit gives no answer: " + "; ".join(self.diagnosis.problems))
        return self

    def vertices(self, vertices: Tensor) -> Tensor:
        """Vertices (V,3) of the shape's own frame, in the world."""
        return self.state.to_world(vertices.to(self.state.theta))

    def record(self, level: float = 0.9) -> dict[str, Any]:
        """Everything as plain numbers, for JSON."""
        names = [p.name for p in self.parameters]
        ends = self.posterior.intervals(level).tolist()
        deviations = self.posterior.deviations.tolist()
        diagnosis = self.diagnosis
        return {
            "trusted": diagnosis.trusted,
            "problems": list(diagnosis.problems),
            "warnings": list(diagnosis.warnings),
            "theta": {
                p.name: {"estimate": float(v), "deviation": d, "interval": e, "unit": p.unit}
                for p, v, d, e in zip(self.parameters, self.state.theta, deviations, ends, strict=False)
            },
            "level": level,
            "pose": {
                "rotation": self.state.rotation.tolist(),
                "translation_mm": self.state.translation.tolist(),
                "centre_mm": self.state.centre.tolist(),
                "deviations": dict(zip(POSE_NAMES, deviations[len(names) :], strict=True)),
            },
            "covariance": self.posterior.covariance.tolist(),
            "appearance": {
                side: {"mean": mixture.mean, "deviation": mixture.deviation, "components": len(mixture.means)}
                for side, mixture in (("inside", self.appearance.inside), ("outside", self.appearance.outside))
            },
            **({} if self.blur is None else {"blur": {"estimate": self.blur[0], "deviation": self.blur[1]}}),
            **({} if self.formation is None else {"formation": self.formation.record()}),
            "objective": self.objective,
            "converged": diagnosis.converged,
            "misfit": diagnosis.misfit,
            "explained": diagnosis.explained,
            "contrast": diagnosis.contrast,
            "gain_nats": diagnosis.gain,
            "evaluations": self.evaluations,
            "steps": self.steps,
            "seconds": self.seconds,
        }

    def _repr_html_(self) -> str:
        found = self.record()
        facts: dict[str, object] = {"trusted": self.trusted}
        for name, value in found["theta"].items():
            low, high = value["interval"]
            facts[name] = f"{value['estimate']:.4g} {value['unit']}, 90 % within {low:.4g} to {high:.4g}"
        facts |= {name: found[name] for name in ("explained", "contrast", "misfit", "seconds")}
        return facts_table("Fit", facts, [*self.diagnosis.problems, *self.diagnosis.warnings])

    def save(self, path: str | Path) -> None:
        """Write `record` as JSON; atomic."""
        write_json(path, self.record())


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit normals (V,3) of vertices, the faces' by area."""
    corners = vertices[faces.long()]
    by_face = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = torch.zeros_like(vertices)
    for corner in range(3):
        total.index_add_(0, faces[:, corner].long(), by_face)
    return torch.nn.functional.normalize(total, dim=1)
