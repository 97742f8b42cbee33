"""Constants of the cochlea family, tuned once to the mean of 15 real human scalae tympani.

Source of the measurements: Froehlich 2024, Vianna research group, Hannover (CC BY 4.0). `python -m
sdm.bench.fit.cochlea_family` measures how close the family comes with these constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Turning angle [degrees]; half-width of the section along the radius, height above and below the centre line [mm];
# slope of the section (rise over radius). All in the half-plane through the axis.
SECTIONS = (
    (0, 1.00, 0.75, 0.74, 0.45),
    (15, 1.11, 0.70, 0.65, 0.18),
    (35, 1.12, 0.65, 0.60, 0.00),
    (70, 1.05, 0.55, 0.60, -0.05),
    (120, 0.95, 0.52, 0.52, 0.05),
    (200, 0.95, 0.47, 0.47, 0.10),
    (280, 0.94, 0.35, 0.55, 0.03),
    (360, 0.84, 0.34, 0.57, 0.06),
    (450, 0.77, 0.38, 0.57, 0.15),
    (540, 0.69, 0.42, 0.40, 0.28),
    (671, 0.69, 0.40, 0.40, 0.32),
)


@dataclass(frozen=True)
class CochleaDesign:
    """Constants that all cochleae of the family have in common. Lengths in mm, angles in radians."""

    sections: tuple[tuple[float, ...], ...] = SECTIONS
    # The spiral that the sections were measured on, and how their size follows the radius: size ~ radius^power.
    radius: float = 3.6
    decay: float = 0.139
    power: float = 1.0 / 3.0
    # The hook: near its base the scala leaves the spiral, r = a exp(-b t) exp(hook (1 - t / hook_end)^2).
    hook: float = 0.35
    hook_end: float = 1.35
    # Rise of the centre line [mm/rad], and where its wave has its crest for phi = 0.
    rise: float = 0.22
    phase: float = -float(np.pi)
    # The wave fades where the spiral's radius falls below this.
    fading: float = 1.0
    # Largest half-width as a share of the radius; largest height as a share of half the room to the next turn.
    inner: float = 0.85
    share: float = 0.9
    # Superellipse exponents of the section: flat on top, round below.
    top: float = 4.0
    bottom: float = 2.0

    @property
    def end(self) -> float:
        """Turning angle of the apical end [rad]."""
        return float(np.radians(self.sections[-1][0]))

    def stations(self, angles: np.ndarray) -> np.ndarray:
        """The kernel's table (S,8) float64 for turning angles (S,) [rad]."""
        # A fifth of a second to import, which most commands that import families do not need.
        from scipy.interpolate import PchipInterpolator

        table = np.asarray(self.sections, dtype=np.float64)
        # Monotone cubics: no overshoot, one derivative.
        width, top, bottom, slope = PchipInterpolator(np.radians(table[:, 0]), table[:, 1:])(angles).T
        size = (self.radius * np.exp(-self.decay * angles)) ** self.power
        hook = np.exp(self.hook * np.clip(1 - angles / self.hook_end, 0, None) ** 2)
        columns = [angles, hook, width / size, top / size, bottom / size, slope, np.cos(angles), np.sin(angles)]
        return np.stack(columns, 1)

    def constants(self) -> np.ndarray:
        """The kernel's constants (6,)."""
        return np.array([self.rise, self.phase, self.fading, self.inner, self.share / 2, self.power])
