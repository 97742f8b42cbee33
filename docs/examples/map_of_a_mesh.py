"""The map of a mesh of yours: `python map_of_a_mesh.py bunny.ply`. Without a file it takes the built-in cochlea."""

import sys

import sdm
from sdm.viz.figure import picture

mesh = sdm.load_mesh(sys.argv[1]) if len(sys.argv) > 1 else sdm.shapes.Cochlea(5_000).mesh([3.6, 0.3, 0.139, -0.17])
report = sdm.inspect_mesh(mesh)
print(
    f"{report.triangles:,} triangles, closed: {report.closed}; sign: {report.recommended_sign}, {report.recommendation}"
)

grid = sdm.Grid.around(mesh, resolution=64, margin=0.1)
field = sdm.signed_distance_map(mesh, grid, sign=report.recommended_sign)
print(f"deepest inside: {-float(field.values.min()):.3f}; voxels inside: {int((field.values < 0).sum()):,}")

field.save("map_of_a_mesh.nii.gz")
picture(field, "map_of_a_mesh.png", title="An exact signed distance map")
