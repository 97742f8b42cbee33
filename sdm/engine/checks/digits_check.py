"""Check of meshes that float32 rounds, where no grid says how fine they are looked at."""

from __future__ import annotations

from sdm.core.mesh import TriangleMesh
from sdm.engine.checks.caller_warning import state, warn
from sdm.inspect.quick_look import look_at


def look_at_digits(mesh: TriangleMesh, name: str | None = None) -> bool:
    """Warn if a mesh lies so far from the origin that float32 rounds its shape.

    Args:
        mesh: As it was given: moved to the origin it has no other digits.
        name: For the warning, in place of the mesh's own.

    Returns:
        True if there was something to say.
    """
    if state.are_off or not (problems := look_at(mesh).lost_digits(mesh)):
        return False
    warn(f"{state.prefix}{name or mesh.name}: {problems[0]}")
    return True
