"""A statistical shape model of a folder of meshes: its mean, its modes, and fresh shapes like those of the folder."""

import tempfile
from pathlib import Path

import torch

import sdm
from sdm.shapes.models.build_model import build_model
from sdm.viz.model_sheet import model_sheet

SHAPES = 8

# A folder such as yours: beans, long or short, bent or straight. Each has triangles of its own.
folder = Path(tempfile.mkdtemp())
length, bend = torch.rand(2, SHAPES, generator=torch.Generator().manual_seed(0))
for number in range(SHAPES):
    ball = sdm.shapes.make_family("ellipsoid").mesh([0.25, 0.25, 0.5 + 0.3 * float(length[number]), 0, 0, 0])
    x, y, z = ball.vertices.unbind(1)
    bean = sdm.TriangleMesh(torch.stack([x + float(bend[number]) * z**2, y, z], 1), ball.faces)
    sdm.signed_distance_map(bean, 20 + number).to_mesh().save(folder / f"bean{number}.ply")

meshes = [sdm.load_mesh(path) for path in sorted(folder.glob("*.ply"))]
model = build_model(meshes, triangles=400, modes=2)
off = sum(row["distance"] for row in model.facts["shapes"]) / SHAPES
print(
    f"the template is {off:.4f} from the meshes on average; {model.facts['compactness'][1]:.0%} of variance in 2 modes"
)

model.save("beans.npz")
fresh = next(iter(sdm.SDMStream(model, model.grid(16), batch_size=4, seed=0)))
print(f"a stream of shapes like these: theta {tuple(fresh.theta.shape)} in deviations, maps {tuple(fresh.sdm.shape)}")

ends = [[0, 0], [-2, 0], [2, 0], [0, -2], [0, 2]]
shapes = [model.mesh([float(t) for t in theta]).numpy() for theta in ends]
model_sheet(shapes, model.facts, Path("shape_model.png"), title="Beans: mean, and modes at 2 deviations")
