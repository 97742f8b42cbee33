"""Registry of shape families by name: a new family is one file and one line here."""

from __future__ import annotations

from typing import Any

from sdm.errors import MeshError
from sdm.shapes.cochlea import Cochlea
from sdm.shapes.family import Family
from sdm.shapes.mesh_folder import MeshFolder
from sdm.shapes.models.statistical_shape import StatisticalShape
from sdm.shapes.solids import Cuboid, Cylinder, Ellipsoid, GeometricShapes, Rhomboid

# In the order in which commands name them. Datasets keep these names: they never change.
families: dict[str, type[Family]] = {
    family.name: family
    for family in (
        Cochlea,
        Cuboid,
        Rhomboid,
        Ellipsoid,
        Cylinder,
        GeometricShapes,
        MeshFolder,
        StatisticalShape,
    )
}


def make_family(name: str, *args: Any, **options: Any) -> Family:
    """The family with this name, for example `make_family("cochlea", triangles=2000)`.

    Args:
        name: A key of `families`.
        args: Of the family's class.
        options: Of the family's class.

    Raises:
        MeshError: There is no family of that name, or it refuses the options.
    """
    if not isinstance(name, str) or name not in families:
        raise MeshError(f"there is no family called {name!r}; use {', '.join(families)}")
    return families[name](*args, **options)
