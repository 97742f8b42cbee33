"""Shape families: parameters to vertices on the device, with fixed faces. See README.md beside this file."""

from sdm.shapes.cochlea import Cochlea
from sdm.shapes.cochlea_design import CochleaDesign
from sdm.shapes.family import Family, Group, Parameter
from sdm.shapes.mesh_folder import MeshFolder
from sdm.shapes.models.statistical_shape import StatisticalShape
from sdm.shapes.named_family import family_record, load_family
from sdm.shapes.registry import families, make_family
from sdm.shapes.sampling import grid, sobol, uniform
from sdm.shapes.solids import Cuboid, Cylinder, Ellipsoid, GeometricShapes, Rhomboid

__all__ = [
    "Cochlea",
    "CochleaDesign",
    "Cuboid",
    "Cylinder",
    "Ellipsoid",
    "Family",
    "GeometricShapes",
    "Group",
    "MeshFolder",
    "Parameter",
    "Rhomboid",
    "StatisticalShape",
    "families",
    "family_record",
    "grid",
    "load_family",
    "make_family",
    "sobol",
    "uniform",
]
